//! Manual installation from a checkout, and the demo with the user's own files.

use peernet_tests::network::Host;
use peernet_tests::{Api, Document, DocumentedCommands, ProcessEnd};

pub(crate) const COMMANDS: [&str; 13] = [
    "install -m 755 -s target/release/peernetd /usr/bin/",
    "ln -sf peernetd /usr/bin/peernet",
    "install -m 644 -D -t /etc/systemd/system deploy/systemd/*.service",
    "install -m 644 -D deploy/sysusers.d/peernet.conf /etc/sysusers.d/peernet.conf",
    "install -m 644 -D deploy/tmpfiles.d/peernet.conf /etc/tmpfiles.d/peernet.conf",
    "deploy/onnxruntime/fetch.py --dest /usr/lib/peernet",
    "systemd-sysusers",
    "systemd-tmpfiles --create",
    "install -m 644 -D -t /etc/peernet deploy/debian/etc/*.toml",
    "install -m 644 -D -t /usr/share/peernet/models/quality-control models/quality-control/model.*",
    "peernetd check /etc/peernet/agent.toml",
    "peernetd check /etc/peernet/aggregator.toml",
    DEMO,
];

const DEMO: &str = "deploy/demo.sh target/demo/peernetd FOLDER";

fn assert_success(end: &ProcessEnd) {
    assert_eq!(end.code(), 0, "{}", end.log);
}

/// Waits until a pipeline on the dashboard of a host has answers.
fn wait_until_answered(host: &Host, port: u16, pipeline: &'static str) {
    host.run_in_namespace(move || {
        Api::on_port(port).wait_until("/api/v1/runs", |runs| {
            let mut runs = runs["runs"].as_array()?.iter();
            runs.any(|run| run["pipeline"] == pipeline && run["counts"]["ok"].as_u64() > Some(5))
                .then_some(())
        });
    });
}

#[test]
fn manual_installation_matches_paths_of_units() {
    let machines = DocumentedCommands::new(&COMMANDS);
    let (edge, machine_root) = (machines.edge(), machines.root_of(machines.edge()));
    let root = machine_root.display().to_string();
    for folder in ["etc", "usr/bin", "usr/lib"] {
        std::fs::create_dir_all(machine_root.join(folder)).expect("writable");
    }
    // The library that the command would download exists already.
    let library = peernet_tests::onnxruntime();
    assert_success(
        &machines.run_on(edge, &format!("cp -a {} {root}/usr/lib/peernet", library.display())).wait_for_end(),
    );

    let programs = format!("{root}/usr/bin/");
    let [users, folders] = ["sysusers", "tmpfiles"].map(|tool| format!("systemd-{tool} --root={root}"));
    let replacements: [(&str, &str); 3] =
        [("/usr/bin/", &programs), ("systemd-sysusers", &users), ("systemd-tmpfiles", &folders)];
    // The first ten commands install; checks and the demo follow.
    for command in &COMMANDS[..10] {
        let changes: Vec<_> = replacements.into_iter().filter(|(from, _)| command.contains(from)).collect();
        assert_success(&machines.on_edge(command, &changes).wait_for_end());
    }
    for role in ["agent", "aggregator"] {
        let unit = machine_root.join(format!("etc/systemd/system/peernet-{role}.service"));
        let unit = std::fs::read_to_string(unit).expect("it was installed");
        let start =
            unit.lines().find_map(|line| line.strip_prefix("ExecStart=")).expect("the unit has ExecStart");
        for file in start.split(' ').filter_map(|word| word.strip_prefix('/')) {
            assert!(machine_root.join(file).is_file(), "{start}");
        }
        assert!(machine_root.join("var/lib/peernet").join(role).is_dir(), "{role}");

        // The installed file names folders of the system. In this test a folder of the machine stands for its root.
        let file = format!("/etc/peernet/{role}.toml");
        let text = std::fs::read_to_string(machine_root.join(&file[1..])).expect("it was installed");
        machines.install(edge, &file, &text, &[]);
        let installed = format!("{programs}peernetd");
        let check = format!("peernetd check {file}");
        assert_success(&machines.on_edge(&check, &[("peernetd", &installed)]).wait_for_end());
    }
    run_demo(&machines);
    machines.finish();
}

/// Runs the demo with the user's own files: the shipped ones with another port of the dashboard.
fn run_demo(machines: &DocumentedCommands) {
    for name in ["aggregator", "cloud", "edge"] {
        let text = Document::read(format!("configs/{name}.toml")).text;
        machines.write(&format!("mine/{name}.toml"), &text.replace("127.0.0.1:8040", "127.0.0.1:8050"));
    }
    let demo = machines.on_edge(DEMO, &[("FOLDER", "mine")]);
    demo.wait_for("http://127.0.0.1:8050/api/v1/pipelines");
    wait_until_answered(machines.edge(), 8050, "offload-resized");
    let end = demo.stop();
    assert_success(&end);
    assert!(end.log.contains("demo: stopped"), "{}", end.log);
}
