"""Checks the results of the teleoperated arm. Usage: check.py FOLDER_OF_RESULTS"""
import csv
import json
import pathlib
import statistics
import sys

# Smallest delay that deploy/test-links.sh adds to an upload, by the label of the axis Network; seconds.
MIN_UPLOAD_S = {"LAN": 0.0, "CAN": 0.001, "5G": 0.06}
RUNS = 9


def rows_of(folder):
    with open(folder / "data.csv") as text:
        return list(csv.DictReader(text))


def check_run(folder):
    """Checks one run; returns its network, whether its pictures were resized, and the median of its uploads."""
    settings = dict(json.loads((folder / "run.json").read_text())["experiment"]["configuration"])
    rows = rows_of(folder)
    assert {row["episode"] for row in rows} == {"0", "1", "2"}, folder
    for row in rows:
        assert row["outcome"] == "ok", row
        # The reward is the negative distance from the tip to the target, metres.
        assert -2.0 < float(row["reward"]) <= 0.0, row
        # Rendering takes tens of milliseconds, and is not part of the iteration.
        assert float(row["capture"]) < 0.05, row
        drawn = float(row["inference_drawn-latency"])
        assert float(row["inference"]) >= drawn, row
    counted = [row for row in rows if row["warm-up"] == "0"]
    network = settings["Network"]
    uploads = [float(row["upload"]) for row in counted if row["upload"]]
    if network == "none":
        assert not uploads, folder
    else:
        # A delay has no value until the clocks of both hosts are related.
        assert len(uploads) > len(counted) / 2, folder
        assert min(uploads) >= MIN_UPLOAD_S[network], folder
    # The first episode is warm-up and has no result.
    last_steps = [row for row, following in zip(rows, [*rows[1:], None]) if following is None or following["step"] == "0"]
    assert all(row["episode-success"] in ("0", "1", "0.0", "1.0") for row in last_steps[1:]), last_steps
    return network, settings["Resize"], statistics.median(uploads) if uploads else 0.0


def main():
    folders = sorted(pathlib.Path(sys.argv[1], "runs").iterdir())
    uploads = {}
    for folder in folders:
        network, resize, upload = check_run(folder)
        uploads.setdefault((network, resize), []).append(upload)
    assert sum(map(len, uploads.values())) == RUNS, uploads
    assert max(uploads["LAN", "no"]) < min(uploads["CAN", "no"]), uploads
    assert max(uploads["CAN", "yes"]) < min(uploads["CAN", "no"]) < min(uploads["5G", "yes"]), uploads
    print("mujoco: all checks passed;", {"/".join(key): [round(upload, 4) for upload in value] for key, value in uploads.items()})


main()
