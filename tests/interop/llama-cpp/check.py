"""Checks models of kind `openai` against llama.cpp's server, on the edge and on a cloud. Usage: check.py FOLDER_OF_PROGRAMS"""
import csv
import glob
import os
import sys
import tempfile

from processes import Process, free_port

ITERATIONS, MAX_TOKENS = 20, 24

MODEL = """
[[model]]
name = "vlm"
kind = "openai"
url = "{url}/v1"
model = "random"
prompt = "Where is the plate?"
parameters = {{ max_tokens = {tokens}, temperature = 1.0, seed = 7, ignore_eos = true }}
"""

CLOUD = """
[agent]
name = "cloud"
state_dir = "{folder}/cloud"

[serve]
listen = "tcp://127.0.0.1:{port}"
"""

EXPERIMENT = """
[experiment]
name = "language-model"
order = "declared"
iterations = {iterations}
warm_up = {{ iterations = 2 }}

[pipeline]
sensor = {{ kind = "text", length = 40 }}
placement = {{ kind = "remote", peer = "tcp://127.0.0.1:{port}", model = "vlm" }}

[[axis]]
name = "Where"

[[axis.value]]
label = "local"
set = {{ "pipeline.placement" = {{ kind = "local", model = "vlm" }} }}

[[axis.value]]
label = "cloud"
"""


def write(path, text):
    with open(path, "w") as file:
        file.write(text)
    return path


def check_rows(file, is_remote):
    with open(file) as text:
        rows = [row for row in csv.DictReader(text) if row["warm-up"] == "0"]
    assert len(rows) == ITERATIONS, len(rows)
    for row in rows:
        assert row["outcome"] == "ok", row
        number = lambda name: float(row[f"inference_{name}"])
        inference, first = float(row["inference"]), number("time-to-first-token")
        assert 0 < number("connect") <= first <= inference, row
        assert number("output-tokens") == MAX_TOKENS, row
        assert 1 <= number("output-chunks") <= MAX_TOKENS, row
        assert number("input-tokens") > 10 and number("finish-reason-length") == 1, row
        assert 0 < number("time-per-output-token") * (MAX_TOKENS - 1) <= inference, row
        assert number("inter-token-latency") <= number("inter-token-latency-max"), row
        assert (row["upload"] != "") == is_remote, row
        if is_remote:
            # Each chunk crossed the network as a partial answer.
            assert float(row["parts"]) == number("output-chunks"), row
            assert first < float(row["first-part"]) < float(row["total"]), row
            assert float(row["first-part-download"]) >= 0, row
    first = sorted(float(row["inference_time-to-first-token"]) for row in rows)[len(rows) // 2]
    token = sorted(float(row["inference_time-per-output-token"]) for row in rows)[len(rows) // 2]
    print(f"ok    {file}: first token {first * 1e3:.2f} ms, then {token * 1e6:.0f} µs per token (medians)", flush=True)


def main():
    programs = os.path.abspath(sys.argv[1])
    here = os.path.dirname(os.path.abspath(__file__))
    with tempfile.TemporaryDirectory(prefix="interop-llama-cpp-") as folder:
        with Process(sys.executable, os.path.join(here, "serve.py"), folder, free_port()) as server:
            url = server.wait_for("serving ").split()[-1]
            port = free_port()
            model = MODEL.format(url=url, tokens=MAX_TOKENS)
            cloud = write(os.path.join(folder, "cloud.toml"), CLOUD.format(folder=folder, port=port) + model)
            experiment = EXPERIMENT.format(port=port, iterations=ITERATIONS) + model
            experiment = write(os.path.join(folder, "experiment.toml"), experiment)
            results = os.path.join(folder, "results")
            with Process(os.path.join(programs, "peernetd"), "run", cloud) as agent:
                run = [os.path.join(programs, "peernet"), "run", experiment, "--result-loc", results]
                with Process(*run) as command:
                    command.finish()
                agent.stop()
            for where in ["local", "cloud"]:
                [file] = glob.glob(os.path.join(results, "runs", f"*{where}*", "data.csv"))
                check_rows(file, is_remote=where == "cloud")
            server.finish()
    print("llama.cpp's server: all checks passed")


main()
