//! Tests of `peernet plot`: figures of results, including those of the paper's program.

use std::path::Path;

use peernet_tests::{LoopbackDeployment, Process, ProcessEnd, program};

use crate::results::write_published_results;

/// Returns a deployment with results in which one upload took 9 s and all others about 18 ms.
fn deployment() -> LoopbackDeployment {
    write_published_results(
        |iteration| if iteration == 90 { 9.0 } else { 0.0175 + f64::from(iteration % 13) * 1e-4 },
    )
}

fn plot(deployment: &LoopbackDeployment, arguments: &[&str]) -> ProcessEnd {
    Process::start(&program("peernet"), &[&["plot"], arguments].concat(), deployment.folder(), &[])
        .wait_for_end()
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).expect("written")
}

#[test]
fn plot_draws_figures_of_paper_for_published_results() {
    let deployment = deployment();
    let end = plot(&deployment, &["all/small", "--kind", "histograms"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    let times = ["sensing-time", "upload-time", "inference-time", "download-time"];
    for stem in times.into_iter().chain(["upload-throughput", "download-throughput"]) {
        let png = deployment.folder().join(format!("all/small/{stem}.png"));
        assert!(std::fs::read(png).expect("written").starts_with(b"\x89PNG"), "{stem}");
        assert!(end.log.contains(&format!("{stem}.svg")), "{}", end.log);
    }
    let upload = read(&deployment.folder().join("all/small/upload-time.svg"));
    assert!(upload.contains("n = 200") && upload.contains("1 beyond 18.7 ms →"), "{upload}");
    let caption = read(&deployment.folder().join("all/small/upload-time-caption.txt"));
    assert!(caption.contains("n = 200 · left out: 5 warm-up"), "{caption}");
    let pdf = std::fs::read(deployment.folder().join("all/small/upload-time.pdf")).expect("written");
    assert!(pdf.starts_with(b"%PDF"));
}

#[test]
fn several_runs_get_own_and_joint_figures() {
    let deployment = deployment();
    let end = plot(&deployment, &["all", "--out", "figures"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    let stacked = read(&deployment.folder().join("figures/stacked.svg"));
    assert!(
        ["small", "large", "inference", "Latency, ms"].iter().all(|text| stacked.contains(text)),
        "{stacked}"
    );
    assert!(deployment.folder().join("figures/large/series.png").is_file(), "{}", end.log);
    assert!(
        !deployment.folder().join("all/large/series.png").exists(),
        "--out leaves the result folders unchanged"
    );
    assert!(!end.log.contains("payload"), "all messages have one size: {}", end.log);
}

#[test]
fn plot_names_runs_without_answers() {
    let deployment = deployment();
    let folder = deployment.folder().join("all/silent");
    std::fs::create_dir(&folder).expect("made");
    let rows = "iteration,sensing,warm-up,outcome\n1,0.001,0,lost\n2,0.001,0,lost\n";
    std::fs::write(folder.join("data.csv"), rows).expect("written");
    let end = plot(&deployment, &["all", "--out", "figures"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    let message = "figures/silent: cannot draw series: no successful iteration";
    assert!(end.log.contains(message), "{}", end.log);
    assert_eq!(
        end.log.matches("cannot draw").count(),
        1,
        "only one figure is named as not drawn: {}",
        end.log
    );
}

#[test]
fn plot_errors_are_named() {
    let deployment = deployment();
    let cases: [(&[&str], i32, &str); 5] = [
        (&["all", "--kind", "payload"], 65, "it needs messages of different sizes over one network"),
        (&["all", "--kind", "paired"], 65, "two placements"),
        (&["all/small", "--kind", "histograms", "--x", "nonsense"], 65, "the column nonsense"),
        (&["nowhere"], 66, "no results in nowhere"),
        (&["all", "--y", "total"], 64, "use one of these kinds"),
    ];
    for (arguments, code, text) in cases {
        let end = plot(&deployment, arguments);
        assert_eq!(end.code(), code, "{arguments:?}: {}", end.log);
        assert!(end.log.contains(text), "{arguments:?}: {}", end.log);
    }
}
