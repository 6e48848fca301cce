"""Exports a random model and writes down torchvision's own answers, for the tests of models in this folder.

Arguments: the folder for the output, then pictures. The output is the folder of the model, and answers.json with one object
for each picture: file, width, height, the file of its decoded pixels, logits.
"""

import json
import sys
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[4] / "models"))
import export_torchvision  # noqa: E402
import torch  # noqa: E402


def main(folder: Path, pictures: list[Path]) -> None:
    (exported,) = export_torchvision.main(
        ["efficientnet_v2_s", "--weights", "none", "--seed", "3", "--models-dir", str(folder), "--overwrite"]
    )
    answers = []
    for number, file in enumerate(pictures):
        picture = Image.open(file).convert("RGB")
        pixels = folder / f"{number}.rgb"
        pixels.write_bytes(picture.tobytes())
        with torch.no_grad():
            logits = exported.model(exported.transforms(picture).unsqueeze(0))[0]
        answers.append({"file": str(file), "width": picture.width, "height": picture.height, "pixels": str(pixels),
                        "logits": logits.tolist()})
    (folder / "answers.json").write_text(json.dumps(answers), encoding="utf-8")


main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
