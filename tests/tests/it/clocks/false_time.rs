//! A whole process under libfaketime: a wrong clock that it knows nothing of.

use std::path::PathBuf;

use peernet_clock::Span;
use peernet_tests::truth::{Delay, HostClock, Iteration};
use peernet_tests::{Network, Plant, Process};

use super::{WARM_UP, hold_to_the_truth, say};

/// How far ahead the edge is.
const AHEAD: Span = Span::from_millis(137);

/// Debian keeps it in a folder of its own, one per architecture.
fn libfaketime() -> PathBuf {
    let folders = std::fs::read_dir("/usr/lib").expect("every Linux has /usr/lib").flatten();
    let mut found =
        folders.map(|folder| folder.path().join("faketime/libfaketimeMT.so.1")).filter(|path| path.exists());
    found.next().expect("libfaketime is installed: run `deploy/install-tools.sh test`")
}

/// Shows the edge a time that is ahead of the kernel's, from now on or from within a second.
fn show(plant: &Plant, ahead: Span) {
    let file = plant.folder().join("ahead");
    let new = file.with_extension("new");
    std::fs::write(&new, format!("+{}s\n", ahead.seconds())).expect("the temporary folder is writable");
    std::fs::rename(new, file).expect("the temporary folder is writable");
}

/// An edge that is shown a false time, and a cloud that is not.
fn start(plant: &Plant, load: &str) -> (Process, Process) {
    show(plant, AHEAD);
    let cloud = plant.cloud("[clock]\ndiscipline = []\n");
    let (library, file) = (libfaketime().display().to_string(), plant.folder().join("ahead"));
    let file = file.display().to_string();
    let environment = [
        ("LD_PRELOAD", library.as_str()),
        ("FAKETIME_TIMESTAMP_FILE", &file),
        ("FAKETIME_CACHE_DURATION", "1"),
        ("DONT_FAKE_MONOTONIC", "1"),
    ];
    // The kernel's word on its clock is not about the one that is shown.
    let clock = "clock_identity = \"shown\"\n[clock]\ntimestamps = \"user\"\ndiscipline = []\n";
    let edge = plant.edge(&format!("{clock}{}", plant.pipeline("misled", 1000, load)), &environment);
    (cloud, edge)
}

#[test]
fn an_edge_that_is_shown_a_false_time_reports_true_delays() {
    let plant = Plant::new(|_| Network::direct());
    let _hosts = start(&plant, "load = { mode = \"rate\", hz = 50.0 }\nlimit = { iterations = 300 }");
    plant.finished(1);
    let (edge, cloud) = (HostClock::ahead_by(&[AHEAD]), HostClock::kernels());
    let (up, down) = hold_to_the_truth("libfaketime +0.137 s", &plant.iterations(), &edge, &cloud);
    assert_eq!((up.compared, down.compared), (305, 305));
    // A false time that does not reach the program would make every true delay negative or an eighth of a second.
    assert!(up.truth(0.0) > Span::ZERO && up.truth(0.5) < Span::from_millis(100), "{}", up.in_words());
}

/// No rehearsal that knows of its own steps: the edge has to find out.
#[test]
fn a_step_that_nobody_announced_is_noticed() {
    const LATER: Span = Span::from_millis(3_137);
    let plant = Plant::new(|_| Network::direct());
    let _hosts = start(&plant, "load = { mode = \"rate\", hz = 100.0 }\nlimit = { iterations = 1500 }");
    plant.api.until("/api/v1/pipelines/edge/misled", |pipeline| {
        (pipeline["windows"][2]["counts"]["ok"].as_f64()? >= 400.0).then_some(())
    });
    show(&plant, LATER);
    plant.finished(1);

    let iterations = plant.iterations();
    let (edge, cloud) = (HostClock::ahead_by(&[AHEAD, LATER]), HostClock::kernels());
    hold_to_the_truth("libfaketime, set by +3 s", &iterations, &edge, &cloud);
    let ahead = |iteration: &Iteration| iteration.up.sent - cloud.truth(iteration.up.received);
    let stepped = |iteration: &&Iteration| ahead(iteration) > Span::from_seconds(1);
    let first = iterations.iter().find(stepped).expect("the time that is shown was changed");
    let at = cloud.truth(first.up.received);
    let since = |iteration: &Iteration| cloud.truth(iteration.up.received) - at;
    let good = |delay: &Delay| ["ok", "limited"].contains(&delay.verdict.as_str());
    let bad = iterations.iter().filter(|iteration| iteration.number > WARM_UP);
    let bad: Vec<_> = bad.filter(|iteration| !good(&iteration.up) || !good(&iteration.down)).collect();
    let times: Vec<Span> = bad.iter().map(|iteration| since(iteration)).collect();
    say(&format!("libfaketime, set by +3 s: neither ok nor limited {times:?} after it"));
    assert!(iterations.iter().any(|iteration| since(iteration) > Span::from_seconds(5)));
    let near = Span::from_seconds(-1)..Span::from_seconds(5);
    assert!(times.iter().all(|time| near.contains(time)), "{bad:?}");
}
