"""Makes inter.ttf from the dashboard's font (web/assets/inter.woff2): one weight, no layout tables but kerning, because
figures are drawn without system fonts. The result is committed; the build does not need Python.

    pip install fonttools brotli && python instance.py
"""

import io
from pathlib import Path

from fontTools import subset
from fontTools.ttLib import TTFont
from fontTools.varLib import instancer

TEXT = [*range(0x20, 0x7F), *range(0xA0, 0x100), 0x202F]
SIGNS = [ord(sign) for sign in "–—‘’“”…→−≈≤≥∞Δμσ"]


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
    target = here / "inter.ttf"
    font.save(target)
    print(target, target.stat().st_size, "bytes")


main()
