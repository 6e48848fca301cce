//! Commands on one machine: the study of a sensor, checks, models, completion.

use peernet_tests::{Document, DocumentedCommands};

use crate::experiments::{Results, column, wait_for_runs};

pub(crate) const COMMANDS: [&str; 8] = [
    "peernet run configs/experiments/sensor-study.toml",
    "peernet run --check experiment.toml",
    "peernet run --check /dev/stdin",
    "peernet models list",
    "peernet models show NAME",
    "peernet models check NAME",
    "peernet models bench NAME",
    "peernet completions bash > /etc/bash_completion.d/peernet",
];

/// Experiment with the mistake that the document shows.
const EXPERIMENT_WITH_MISTAKE: &str = "[experiment]\nname = 'slip'\niterations = 5\n[pipeline]\nsensor = { kind = 'text', length = 10 }\n\
                    placement = { kind = 'remote', peer = 'tcp://127.0.0.1:5551' }\n[[axis]]\nname = 'Model'\n\
                    [[axis.value]]\nlabel = 'echo'\nset = { 'pipeline.placement.modle' = 'echo' }\n";

#[test]
fn documented_commands_without_aggregator_work() {
    let machines = DocumentedCommands::new(&COMMANDS);
    let execute = |command: &str, changes: &[(&str, &str)]| {
        let end = machines.on_edge(command, changes).wait_for_end();
        (end.code(), end.log)
    };
    let execute_for_model = |command: &str, options: &str| {
        let (code, log) = execute(command, &[("NAME", &format!("quality-control{options}"))]);
        assert_eq!(code, 0, "{command}: {log}");
        log
    };

    machines.copy("configs/experiments/sensor-study.toml", &[("duration_s = 12", "iterations = 20")]);
    let study = wait_for_runs(machines.on_edge("peernet run configs/experiments/sensor-study.toml", &[]), 4);
    assert_eq!(study.code(), 0, "{}", study.log);
    let results = Results::of(machines.folder().join("results/sensor-study"));
    assert_eq!(results.states(), ["finished"; 4]);
    for folder in results.folders() {
        let study = std::fs::read_to_string(results.file(&folder, "sensor.txt")).expect("it was written");
        assert!(study.contains("samples per second"), "{study}");
        // The study has no placement, so nothing is inferred.
        let data = results.file(&folder, "data.csv");
        let inference = column(&data, "inference");
        assert!(!inference.is_empty() && inference.iter().all(String::is_empty), "{folder}: {inference:?}");
    }

    machines.write("experiment.toml", EXPERIMENT_WITH_MISTAKE);
    let (code, log) = execute("peernet run --check experiment.toml", &[]);
    assert_eq!(code, 78, "{log}");
    assert!(Document::read("docs/experiments.md").text.contains(log.trim()), "{log}");

    let redirection = ("/dev/stdin", "/dev/stdin < experiment.toml");
    let (code, log) = execute("peernet run --check /dev/stdin", &[redirection]);
    assert!(code == 78 && log.contains("unknown field `modle`"), "{log}");

    let (code, log) = execute("peernet models list", &[]);
    assert!(code == 0 && log.contains("quality-control"), "{log}");
    assert!(execute_for_model("peernet models show NAME", "").contains("SHA-256"));
    assert!(execute_for_model("peernet models check NAME", "").contains("of 30 labels right"));
    assert!(execute_for_model("peernet models bench NAME", " --iterations 20").contains("inference"));

    let file = ("/etc/bash_completion.d/peernet", "completion.bash");
    let (code, log) = execute("peernet completions bash > /etc/bash_completion.d/peernet", &[file]);
    assert_eq!(code, 0, "{log}");
    assert_eq!(machines.run_on(machines.edge(), "bash -n completion.bash").wait_for_end().code(), 0);
    machines.finish();
}
