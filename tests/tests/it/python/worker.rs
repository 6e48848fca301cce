//! The life of the worker beside that of its agent.

use std::fs;
use std::path::PathBuf;

use peernet_tests::{Site, until};

use super::{CLOUD, EDGE, site, write};

const CONFIGURATION: i32 = 78;

/// The model's process, once there is one.
fn worker(site: &Site) -> PathBuf {
    let number = until("the model is there", || {
        let text = fs::read_to_string(site.folder().join("pid")).ok()?;
        (!text.is_empty()).then_some(text)
    });
    PathBuf::from("/proc").join(number)
}

#[test]
fn no_process_stays_behind_when_the_agent_is_killed() {
    let site = site();
    write(&site, "cloud.toml", &CLOUD.replace("aggregator =", "#"));
    write(&site, "edge.toml", &EDGE.replace("aggregator =", "#"));
    let cloud = site.start("cloud.toml");
    let _edge = site.start("edge.toml");
    let worker = worker(&site);
    assert!(worker.exists());
    cloud.kill();
    until("the worker is gone", || (!worker.exists()).then_some(()));
}

#[test]
fn a_check_names_what_is_missing_and_runs_nothing() {
    let site = site();
    let broken = CLOUD.replace("follower::Follower", "folower::Follower").replace("aggregator =", "#");
    write(&site, "it.toml", &format!("{broken}{}", EDGE.split_once("\n\n").expect("two tables").1));
    let ended = site.peernetd(&["check", "it.toml"]).ended();
    assert_eq!(ended.code(), CONFIGURATION, "{}", ended.log);
    assert!(
        ended.log.contains("model[0]") && ended.log.contains("no Python module folower"),
        "{}",
        ended.log
    );
    assert!(!ended.log.contains("the rig is up"), "{}", ended.log);
    assert!(!site.folder().join("pid").exists(), "no object was made");
}

#[test]
fn a_model_that_dies_is_started_anew() {
    let site = site();
    write(&site, "cloud.toml", &CLOUD.replace("aggregator =", "#"));
    write(&site, "edge.toml", &EDGE.replace("aggregator =", "#"));
    let dies = "
import os
class Follower:
    def infer(self, sample):
        if sample[1][0] == 5:
            os._exit(9)
        return 0
";
    fs::write(site.folder().join("follower.py"), dies).expect("the temporary folder is writable");
    let cloud = site.start("cloud.toml");
    let edge = site.start("edge.toml");
    cloud.wait_for("started anew");
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
}

#[test]
fn a_model_that_hangs_holds_up_neither_iterations_nor_the_end() {
    let site = site();
    write(&site, "cloud.toml", &CLOUD.replace("aggregator =", "#"));
    let edge = EDGE.replace("aggregator =", "#");
    write(&site, "edge.toml", &format!("{edge}timeout_ms = 300\n"));
    let hangs = "
import os, time
open('pid', 'w').write(str(os.getpid()))
class Follower:
    def infer(self, sample):
        print('hanging')
        time.sleep(600)
";
    fs::write(site.folder().join("follower.py"), hangs).expect("the temporary folder is writable");
    let cloud = site.start("cloud.toml");
    let edge = site.start("edge.toml");
    cloud.wait_for("hanging");
    let worker = worker(&site);
    edge.stop();
    cloud.stop();
    until("the worker is gone", || (!worker.exists()).then_some(()));
}
