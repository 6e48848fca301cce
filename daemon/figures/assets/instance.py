"""Makes inter.ttf from the dashboard's font (web/assets/inter.woff2), because figures are drawn without system fonts.
The result has one weight, and kerning is its only layout feature. The result is committed, so the build does not need
Python.

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
    single_weight = io.BytesIO()
    font.save(single_weight)
    options = subset.Options()
    options.layout_features = ["kern"]
    options.legacy_kern = True
    options.hinting = False
    options.notdef_outline = True
    subsetter = subset.Subsetter(options)
    subsetter.populate(unicodes=TEXT + SIGNS)
    font = TTFont(single_weight)
    subsetter.subset(font)
    # SVG figures name the font by its family, so that a program draws them with Inter if Inter is installed. The font
    # in inter.ttf gets the same name, so that PEERNet draws figures with inter.ttf.
    # The name ids of OpenType: 1 is the family, 4 the full name, 6 the PostScript name, 16 the typographic family. The
    # last three arguments are the platform Windows, the encoding Unicode and the language English.
    for name_id in (1, 4, 16):
        if font["name"].getDebugName(name_id):
            font["name"].setName(FAMILY, name_id, 3, 1, 0x409)
    font["name"].setName(FAMILY, 6, 3, 1, 0x409)
    target = here / "inter.ttf"
    font.save(target)
    print(target, target.stat().st_size, "bytes")


main()
