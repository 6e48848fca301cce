//! The seed decides the order and the payloads.

use super::{Lab, column};
use peernet_tests::root;

/// The demo's file, shortened, with this test's cloud.
fn demo(lab: &Lab) -> String {
    let text = std::fs::read_to_string(root().join("configs/experiments/demo.toml")).expect("it is there");
    let shortened = text
        .replace("episodes = 4", "episodes = 2")
        .replace("episode_steps = 25", "episode_steps = 6")
        .replace("127.0.0.1:5551", &format!("127.0.0.1:{}", lab.site.data));
    assert_ne!(text, shortened);
    shortened
}

/// The order, and of each run that sends pictures as they are how large they were.
fn seen(lab: &Lab) -> (Vec<String>, Vec<Vec<String>>) {
    let mut folders = lab.folders();
    let order = folders.clone();
    folders.retain(|folder| folder.contains("-no-") && !folder.contains("local"));
    folders.sort_by_key(|folder| folder[3..].to_owned());
    let sizes = folders.iter().map(|folder| column(&lab.file(folder, "data.csv"), "upload-bytes"));
    (order, sizes.collect())
}

#[test]
fn the_demo_twice_with_one_seed_has_one_order_and_the_same_payloads() {
    let lab = Lab::new();
    let measure = |options: &[&str]| {
        let ended = lab.run(&demo(&lab), options).ended();
        assert_eq!(ended.code(), 0, "{}", ended.log);
        (seen(&lab), ended.log)
    };
    let ((order, sizes), log) = measure(&[]);
    assert_eq!((order.len(), sizes.len()), (10, 4), "{order:?}");
    assert!(log.contains("total (measured)") && log.contains("of 10 runs 10 finished"), "{log}");
    // Configurations get the same pictures; repeats get others.
    assert_eq!((&sizes[0], &sizes[1]), (&sizes[2], &sizes[3]));
    assert_ne!(sizes[0], sizes[1]);
    for name in ["compare.txt", "compare.md", "compare.csv", "compare.tex"] {
        assert!(lab.results().join(name).is_file(), "{name}");
    }
    let compared = column(&lab.results().join("compare.csv"), "Where");
    assert_eq!(compared, ["local", "cloud", "cloud", "echo", "echo"], "in the order of the file");
    let counted = column(&lab.results().join("compare.csv"), "count");
    // Two repeats of one episode without its first step.
    assert!(counted.iter().all(|count| count == "10"), "{counted:?}");

    let again = measure(&["--restart"]).0;
    assert_eq!(again, (order.clone(), sizes.clone()));
    let (other_order, other_sizes) = measure(&["--restart", "--seed", "2"]).0;
    assert_ne!(other_order, order);
    assert_ne!(other_sizes, sizes);
}
