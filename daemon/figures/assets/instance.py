"""Makes inter.ttf from the dashboard's font (web/assets/inter.woff2): one weight, no layout tables but kerning, because
figures are drawn without system fonts. The result is committed; the build does not need Python.

    pip install fonttools brotli && python instance.py
"""

import io
from pathlib import Path

from fontTools import subset
from fontTools.ttLib import TTFont
from fontTools.varLib import instancer

TEXT = [*range(0x20, 0x7F), *range(0xA0, 0x180), 0x2009, 0x202F]
SIGNS = [ord(sign) for sign in "‐‑–—‘’‚“”„•…′″€←↑→↓−∕≈≠≤≥∞ΔΩμσ‰"]
FAMILY = "Inter"


def main() -> None:
    here = Path(__file__).parent
    font = TTFont(here.parents[2] / "web/assets/inter.woff2")
    font.flavor = None
    font = instancer.instantiateVariableFont(font, {"wght": 450})
    plain = io.BytesIO()
    font.save(plain)
    options = subset.Options()
    options.layout_features = ["kern"]
    options.legacy_kern = True
    options.hinting = False
    options.notdef_outline = True
    subsetter = subset.Subsetter(options)
    subsetter.populate(unicodes=TEXT + SIGNS)
    font = TTFont(plain)
    subsetter.subset(font)
    # SVG figures name the font by its family, so that a reader's installed Inter is used. This font has the same name.
    for number in (1, 4, 16):
        if font["name"].getDebugName(number):
            font["name"].setName(FAMILY, number, 3, 1, 0x409)
    font["name"].setName(FAMILY, 6, 3, 1, 0x409)
    target = here / "inter.ttf"
    font.save(target)
    print(target, target.stat().st_size, "bytes")


main()
