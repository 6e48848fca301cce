"""Makes ../inter.woff2 from InterVariable.woff2 (npm package inter-ui 4.1.1): weights 400 to 600, text size,
Latin with the signs that figures need. The result is committed; the build needs neither Python nor npm.

    pip install fonttools brotli && python subset.py InterVariable.woff2
"""

import io
import sys
from pathlib import Path

from fontTools import subset
from fontTools.ttLib import TTFont
from fontTools.varLib import instancer

LATIN = [*range(0x20, 0x7F), *range(0xA0, 0x180)]
SPACES = [0x2002, 0x2003, 0x2009, 0x200A, 0x202F]
SIGNS = [ord(sign) for sign in "‐‑–—‘’‚“”„•…′″‹›⁄€←↑→↓−∕≈≠≤≥∞ΔΩμσ‰✓"]


def main(source: str) -> None:
    options = subset.Options()
    options.layout_features = ["kern", "tnum", "ccmp", "locl", "mark"]
    options.hinting = False
    options.notdef_outline = True
    subsetter = subset.Subsetter(options)
    subsetter.populate(unicodes=LATIN + SPACES + SIGNS)
    # The font is saved and read again before each step, so that each step gets a complete, uncompressed font.
    font = TTFont(source)
    font.flavor = None
    plain = io.BytesIO()
    font.save(plain)
    font = instancer.instantiateVariableFont(TTFont(plain), {"opsz": 14, "wght": (400, 600)})
    plain = io.BytesIO()
    font.save(plain)
    font = TTFont(plain)
    subsetter.subset(font)
    font.flavor = "woff2"
    target = Path(__file__).parent.parent / "inter.woff2"
    font.save(target)
    print(target, target.stat().st_size, "bytes")


main(sys.argv[1])
