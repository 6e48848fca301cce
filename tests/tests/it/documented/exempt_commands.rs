//! Documented commands that are executed outside of these tests, and commands that are never executed.

use std::process::Command;

use peernet_tests::root;

/// Commands, the file that executes them, and an excerpt of this file that shows it. The execution
/// differs from the documents: fewer iterations; random weights, which need no download; a package
/// that is installed in a disposable copy of the machine.
pub(super) const EXECUTED_ELSEWHERE: [(&[&str], &str, &str); 16] = [
    (
        &[
            "PEERNet --server --name cluster --network zmq-tcp --network-config net_config.yaml --model-name efficientnet_v2_s --device cuda:6 --iterations 10005",
            "PEERNet --client --name jetson-orin --network zmq-tcp --network-config net_config.yaml --dataset-loc sample-image.JPEG --iterations 10005 --result-loc results --generate-plots",
        ],
        "tests/tests/it/published/commands.rs",
        "#[test]\nfn published_commands_work_unchanged()",
    ),
    (
        &[
            "python3 models/export_torchvision.py efficientnet_v2_s efficientnet_v2_m efficientnet_v2_l",
            "/usr/bin/python3 models/export_torchvision.py efficientnet_v2_s efficientnet_v2_m efficientnet_v2_l",
            "/usr/bin/python3 models/export_torchvision.py efficientnet_v2_s --weights none",
            "/usr/bin/python3 models/export_torchvision.py resnet50 --weights IMAGENET1K_V1 --models-dir /var/lib/peernet/models",
        ],
        "tests/tests/it/models/torchvision.rs",
        "#[test]\nfn exported_model_answers_like_torchvision()",
    ),
    (
        &["peernet models check defect-detector"],
        "tests/tests/it/models/commands.rs",
        "run_models_command(&[\"check\", \"defect-detector\"])",
    ),
    (
        &["cargo build --release --locked --package peernetd --bin peernetd"],
        "Makefile",
        "\n\t$(CARGO) build --release --locked --package peernetd --bin peernetd --features ros2\n",
    ),
    (
        &[
            "tests/bench/run.sh python",
            "tests/bench/run.sh stream",
            "tests/bench/run.sh pages",
            "tests/bench/run.sh --quick loop",
        ],
        "Makefile",
        "\n\ttests/bench/run.sh\n",
    ),
    (&["deploy/test-links.sh up"], "tests/interop/mujoco/run.sh", "\ndeploy/test-links.sh up\n"),
    (&["deploy/test-links.sh status"], "tests/interop/mujoco/run.sh", "\ndeploy/test-links.sh status\n"),
    (&["deploy/test-links.sh down"], "tests/interop/mujoco/run.sh", "    deploy/test-links.sh down\n"),
    (
        &["ip netns exec peernet-cloud peernetd run configs/teleoperation-cloud.toml"],
        "tests/interop/mujoco/run.sh",
        "\nip netns exec peernet-cloud peernetd run configs/teleoperation-cloud.toml ",
    ),
    (
        &[
            "ip netns exec peernet-edge env PEERNET_PYTHON=$PWD/.venv-teleoperation/bin/python peernet run configs/experiments/teleoperation.toml",
        ],
        "tests/interop/mujoco/run.sh",
        "\nip netns exec peernet-edge env PEERNET_PYTHON=\"$python\" peernet run configs/experiments/teleoperation.toml ",
    ),
    (&["apt install ./peernet_*.deb"], "deploy/debian/test.sh", "apt-get install "),
    (
        &["peernetd run /usr/share/doc/peernet/examples/all-in-one.toml"],
        "deploy/debian/test.sh",
        "    peernetd run /usr/share/doc/peernet/examples/all-in-one.toml ",
    ),
    (
        &["cp -r /usr/share/peernet/models/quality-control/pictures /var/lib/peernet/pictures"],
        "deploy/debian/test.sh",
        "    cp -r /usr/share/peernet/models/quality-control/pictures /var/lib/peernet/pictures\n",
    ),
    (&["apt remove peernet"], "deploy/debian/test.sh", "dpkg --remove peernet\n"),
    (&["apt purge peernet"], "deploy/debian/test.sh", "dpkg --purge peernet\n"),
    (
        &["systemctl enable --now peernet-agent"],
        "deploy/debian/test.sh",
        "systemctl enable --quiet peernet-agent\n",
    ),
];

/// Commands that are never executed; each list follows its reason.
pub(super) const NEVER_EXECUTED: [(&str, &[&str]); 6] = [
    (
        "git would clone the repository that the tests are in",
        &["git clone https://github.com/peernet/peernet && cd peernet"],
    ),
    (
        "systemctl needs a systemd that has started the machine; deploy/systemd/verify.sh checks the units",
        &[
            "systemctl enable --now peernet-aggregator",
            "systemctl daemon-reload",
            "systemctl start peernet-aggregator",
            "systemctl stop peernet-aggregator",
            "systemctl start peernet-agent",
            "systemctl stop peernet-agent",
        ],
    ),
    (
        "gigabytes of libraries for a GPU that the machine of the tests lacks",
        &[
            "python3 -m venv /opt/onnxruntime-gpu",
            "/opt/onnxruntime-gpu/bin/pip install 'onnxruntime-gpu[cuda,cudnn]==1.31.1'",
            "find /opt/onnxruntime-gpu -name 'libonnxruntime.so.*'",
            "find /opt/onnxruntime-gpu -path '*/nvidia/*' -name '*.so.*' -printf '%h\\n' | sort -u",
        ],
    ),
    (
        "gigabytes of weights and a GPU that the machine of the tests lacks; `tests/interop/llama-cpp` runs the same server with random \
         weights",
        &[
            "llama-server --model ggml-model-q4_k.gguf --mmproj mmproj-model-f16.gguf --chat-template vicuna --n-gpu-layers 99 --port 8080",
            "vllm serve llava-hf/llava-1.5-7b-hf --served-model-name default --no-enable-prefix-caching --port 8080",
        ],
    ),
    (
        "a quarter of an hour of training; `tests/interop/mujoco` runs the simulation with the same packages",
        &[
            "python3 -m venv .venv-teleoperation",
            ".venv-teleoperation/bin/pip install -r configs/teleoperation/requirements.txt",
            ".venv-teleoperation/bin/python configs/teleoperation/train.py models/teleoperation-policy",
            "/usr/bin/python3 -m venv --system-site-packages /tmp/teleoperation",
            "/tmp/teleoperation/bin/pip install -r configs/teleoperation/requirements.txt",
            "/tmp/teleoperation/bin/python configs/teleoperation/train.py models/teleoperation-policy",
            "/tmp/teleoperation/bin/python configs/teleoperation/evaluate.py models/teleoperation-policy --delays 0 0.02 0.1 0.2 0.3 0.67",
        ],
    ),
    (
        "packages of PyPI that nothing else needs; `peernet models check` judges the same pictures by the same card",
        &[
            "python3 -m venv /tmp/check && /tmp/check/bin/pip install -r models/quality_control/requirements.txt",
            "/tmp/check/bin/python models/quality_control/check.py models/quality-control",
            "/tmp/check/bin/python models/quality_control/check.py models/quality-control --first-to 320",
            "/tmp/check/bin/python models/quality_control/check.py models/quality-control /tmp/third --write-card",
        ],
    ),
];

#[test]
fn commands_executed_elsewhere_are_in_their_files() {
    for (commands, file, excerpt) in EXECUTED_ELSEWHERE {
        let text = std::fs::read_to_string(root().join(file)).unwrap_or_default();
        assert!(text.contains(excerpt), "{file} has no {excerpt:?}, which would run {commands:?}");
    }
}

/// Returns whether the Makefile has the target of a command, or whether the tools that `make test` installs include
/// its packages; `None` for other commands.
pub(super) fn is_known(command: &str) -> Option<bool> {
    if let Some(targets) = command.strip_prefix("make ") {
        let mut make = Command::new("make");
        // This `make` must not inherit options from the `make` that runs the tests.
        make.arg("--dry-run").args(targets.split(' ')).current_dir(root()).env_remove("MAKEFLAGS");
        return Some(make.output().is_ok_and(|end| end.status.success()));
    }
    let packages = command.strip_prefix("apt-get install ")?;
    let script = std::fs::read_to_string(root().join("deploy/install-tools.sh")).unwrap_or_default();
    let tools: Vec<&str> = script.split_whitespace().collect();
    Some(packages.split(' ').all(|package| tools.contains(&package)))
}
