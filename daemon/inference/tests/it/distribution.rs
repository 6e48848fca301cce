//! Models whose latencies are drawn from a distribution.

use std::fs;
use std::path::Path;

use peernet_inference::{FinishedJob, LoadError, Pool};
use peernet_logger::stage;
use peernet_sample::{Description, Sample};

use super::{answer, bank, jpeg, loaded, pictures, quality_control, run};

const LOG_NORMAL: &str = "name = 'gpu'\nkind = 'distribution'\nmean_ms = 4.0\nstd_ms = 1.0\nseed = 3";

fn bytes() -> Sample {
    Sample::from_part(Description::bytes(), vec![7; 3].into())
}

/// Returns the drawn latency and the duration of `inference`, in seconds.
fn latencies(finished: FinishedJob) -> (f64, f64) {
    let tree = finished.recorder.finish();
    let value =
        |path: &[&str]| tree.find(path).and_then(|(_, node)| node.measure.value()).expect("is recorded");
    (value(&["inference", "drawn-latency"]), value(&["inference"]))
}

fn draw_latencies(pool: &Pool, count: usize) -> Vec<f64> {
    (0..count).map(|_| latencies(run(pool, bytes())).0).collect()
}

#[test]
fn inference_takes_the_drawn_latency() {
    let bank = bank(&[LOG_NORMAL]);
    let pool = loaded(&bank, "gpu");
    for _ in 0..5 {
        let finished = run(&pool, bytes());
        assert_eq!(finished.result.as_ref().map(Sample::payload_bytes), Ok(0));
        let tree = finished.recorder.finish();
        let value =
            |path: &[&str]| tree.find(path).and_then(|(_, node)| node.measure.value()).expect("is recorded");
        let (drawn, inference) = (value(&["inference", "drawn-latency"]), value(&["inference"]));
        assert!(drawn > 0.0 && inference >= drawn, "{inference} {drawn}");
        // A wait always takes a little longer than its time.
        assert!(value(&["inference", "overrun"]) > 0.0);
    }
}

#[test]
fn equal_seeds_draw_equal_latencies() {
    let latencies_of = |table: &str| draw_latencies(&loaded(&bank(&[table]), "gpu"), 8);
    let first = latencies_of(LOG_NORMAL);
    assert_eq!(latencies_of(LOG_NORMAL), first);
    assert_ne!(latencies_of(&LOG_NORMAL.replace("seed = 3", "seed = 4")), first);
    // The sequence does not depend on the number of workers.
    assert_eq!(latencies_of(&format!("{LOG_NORMAL}\nworkers = 3")), first);
}

#[test]
fn load_without_seed_draws_repeatable_seed() {
    let without = LOG_NORMAL.replace("\nseed = 3", "");
    let load = |table: &str| {
        let pool = loaded(&bank(&[table]), "gpu");
        let facts = pool.facts();
        let (_, replayed) = facts.iter().find(|(name, _)| name == "Replayed").expect("is recorded");
        let (_, seed) = replayed.rsplit_once(", seed ").expect("ends with the seed");
        (seed.parse::<u64>().expect("a number"), draw_latencies(&pool, 8))
    };
    let (seed, first) = load(&without);
    assert!(seed < 1 << 53, "{seed}");
    assert_ne!(load(&without), (seed, first.clone()));
    assert_eq!(load(&format!("{without}\nseed = {seed}")), (seed, first));
}

#[test]
fn recorded_latencies_are_replayed_from_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let text =
        "iteration,inference,total,warm-up,outcome\n1,5.0,5.0,1,ok\n2,0.002,0.003,0,ok\n3,0.001,0.004,0,ok\n";
    fs::write(folder.path().join("data.csv"), text).expect("written");
    let table = |path: &Path, more: &str| {
        format!("name = 'gpu'\nkind = 'distribution'\nseed = 0\ndata = {path:?}\n{more}")
    };
    let bank = bank(&[&table(folder.path(), "device = 'A5000'")]);
    let pool = loaded(&bank, "gpu");
    let latencies = draw_latencies(&pool, 20);
    assert!(latencies.iter().all(|drawn| [0.001, 0.002].contains(drawn)), "{latencies:?}");
    assert!(latencies.contains(&0.001) && latencies.contains(&0.002), "{latencies:?}");
    assert_eq!(pool.device(), "A5000");
    let facts = pool.facts();
    let fact = |name: &str| facts.iter().find(|(known, _)| known == name).map(|(_, text)| text.as_str());
    let replayed =
        "inference is drawn from column inference of 2 iterations of a data.csv, with mean 1.50 ms, seed 0";
    assert_eq!(fact("Replayed"), Some(replayed));
    let hash = "printf %s \"$0\" | sha256sum | head -c 64";
    let hash = std::process::Command::new("sh").args(["-c", hash, text]).output().expect("runs").stdout;
    assert_eq!(fact("Replayed SHA-256").map(str::as_bytes), Some(&hash[..]));
    let settings = fact("Model settings").expect("is recorded");
    assert!(!settings.contains(&*folder.path().to_string_lossy()), "the settings contain a path: {settings}");

    // Another column, and the file itself as the path.
    let bank = super::bank(&[&table(&folder.path().join("data.csv"), "column = 'total'")]);
    let latencies = draw_latencies(&loaded(&bank, "gpu"), 5);
    assert!(latencies.iter().all(|drawn| [0.003, 0.004].contains(drawn)), "{latencies:?}");
}

#[test]
fn latency_is_replayed_from_several_columns() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = "preprocessing,inference,postprocessing,warm-up\n0.25,0.125,0.001,0\n0.125,0.125,0.001,0\n";
    fs::write(folder.path().join("data.csv"), text).expect("written");
    let table = |more: &str| {
        format!(
            "name = 'cloud'\nkind = 'distribution'\nseed = 0\ninner = 'nap'\ndata = {:?}\n{more}",
            folder.path()
        )
    };
    let inner =
        "name = 'nap'\nkind = 'sleep'\npreprocessing_ms = 100\ninference_ms = 20\npostprocessing_ms = 0";
    let load = |more: &str| loaded(&bank(&[&table(more), inner]), "cloud");
    let replayed = |pool: &Pool| {
        let fact = pool.facts().into_iter().find(|(name, _)| name == "Replayed");
        fact.map(|(_, text)| text).expect("is recorded")
    };
    // The stages of the inner model take 120 ms, which is shorter than the three stages of each row and no overrun.
    let pool = load("column = ['preprocessing', 'inference', 'postprocessing']");
    let tree = run(&pool, bytes()).recorder.finish();
    let value = |path: &[&str]| tree.find(path).and_then(|(_, node)| node.measure.value());
    let drawn = value(&["inference", "drawn-latency"]).expect("is drawn");
    assert!(drawn >= 0.250, "{drawn}");
    // The overrun is that of the wait for the rest of the latency, and not that of the inner model.
    assert!(value(&["inference", "overrun"]).is_some_and(|overrun| overrun < drawn - 0.120));
    let whole = "inference is drawn from columns preprocessing + inference + postprocessing of 2 iterations of a data.csv, \
                 with mean 314 ms, seed 0";
    assert_eq!(replayed(&pool), whole);
    // The mean of `postprocessing` is below 1 % of the mean latency, so this stage is not named.
    let without = "inference is drawn from column inference of 2 iterations of a data.csv, with mean 125 ms, without \
                   preprocessing (mean 188 ms), seed 0";
    assert_eq!(replayed(&load("")), without);
}

#[test]
fn inner_model_answers_after_drawn_latency() {
    let bank = bank(&[
        "name = 'gpu'\nkind = 'distribution'\nmean_ms = 30.0\nstd_ms = 0.0\ninner = 'qc'",
        &quality_control(),
    ]);
    assert!(bank.check().is_empty(), "{:?}", bank.check());
    let pool = loaded(&bank, "gpu");
    let (file, label) = pictures("pictures").swap_remove(0);
    let mut sample = jpeg(file);
    sample.label = Some("no class of the model".to_owned());
    let finished = run(&pool, sample);
    assert_eq!(answer(finished.result).label, label);
    let tree = finished.recorder.finish();
    let value = |path: &[&str]| tree.find(path).and_then(|(_, node)| node.measure.value());
    assert!(value(&["inference"]) >= Some(0.030));
    assert!(value(&["inference", "inner-model", "preprocessing"]).is_some());
    assert_eq!(
        value(&["preprocessing"]),
        None,
        "the stages of the inner model are not stages of the iteration"
    );
    assert_eq!(value(&[stage::UNKNOWN_LABEL.as_str()]), Some(1.0));
    let facts = pool.facts();
    let fact_count = |name: &str| facts.iter().filter(|(known, _)| known == name).count();
    assert_eq!(["Model", "Inner model", "Model SHA-256", "Classes"].map(fact_count), [1; 4]);
}

#[test]
fn slower_inner_model_is_recorded_as_overrun() {
    let inner =
        "name = 'nap'\nkind = 'sleep'\npreprocessing_ms = 0\ninference_ms = 20\npostprocessing_ms = 0";
    let overrun = |mean_ms: f64| {
        let table =
            format!("name = 'gpu'\nkind = 'distribution'\nmean_ms = {mean_ms}\nstd_ms = 0\ninner = 'nap'");
        let tree = run(&loaded(&bank(&[&table, inner]), "gpu"), bytes()).recorder.finish();
        let value = |path: &[&str]| tree.find(path).and_then(|(_, node)| node.measure.value());
        (value(&["inference", "overrun"]).expect("is recorded"), value(&["inference"]).expect("is recorded"))
    };
    let (overrun_s, inference) = overrun(5.0);
    assert!(overrun_s >= 0.015 && inference >= 0.020, "{overrun_s} {inference}");
    // After the 20 ms of the inner model, the wait for the rest of the latency takes 480 ms.
    let (overrun_s, inference) = overrun(500.0);
    assert!(
        overrun_s < 0.480 && inference >= 0.500,
        "the overrun is only that of the wait: {overrun_s} {inference}"
    );
}

#[test]
fn invalid_distribution_is_refused_with_key() {
    let inner = "name = 'other'\nkind = 'distribution'\nmean_ms = 1.0\nstd_ms = 0.0";
    for (lines, key, reason) in [
        ("", "data", "give one of data, histogram and mean_ms"),
        ("mean_ms = 1.0\nstd_ms = 0.0\ndata = 'x'", "data", "give one of"),
        ("mean_ms = 1.0", "std_ms", "needs its standard deviation"),
        ("data = 'x'\nstd_ms = 1.0", "std_ms", "only a log-normal distribution"),
        ("mean_ms = 0.0\nstd_ms = 1.0", "mean_ms", "above 0"),
        ("mean_ms = 1e9\nstd_ms = 1.0", "mean_ms", "1000000000 is not a latency"),
        ("mean_ms = 1.0\nstd_ms = -1.0", "std_ms", "-1 is not a latency"),
        ("mean_ms = 1.0\nstd_ms = 101.0", "std_ms", "101 is more than 100 times mean_ms"),
        ("histogram = { edges_ms = [1.0], counts = [] }", "histogram", "one more edge than counts"),
        (
            "mean_ms = 1.0\nstd_ms = 0.0\ninner = 'nobody'",
            "inner",
            "no [[model]] of this file is named nobody",
        ),
        ("mean_ms = 1.0\nstd_ms = 0.0\ninner = 'gpu'", "inner", "gpu draws its latencies, too"),
        ("mean_ms = 1.0\nstd_ms = 0.0\ninner = 'other'", "inner", "other draws its latencies, too"),
    ] {
        let bank = bank(&[&format!("name = 'gpu'\nkind = 'distribution'\n{lines}"), inner]);
        match &bank.check()[..] {
            [(0, error @ LoadError::InvalidKey { key: found, .. })] => {
                assert!(*found == key && error.to_string().contains(reason), "{error}");
            }
            errors => panic!("{lines}: {errors:?}"),
        }
        assert!(bank.load(&"gpu".parse().expect("is a name"), None).is_err());
    }
    let bank = bank(&["name = 'gpu'\nkind = 'distribution'\ndata = '/nowhere/data.csv'"]);
    assert!(matches!(&bank.check()[..], [(0, error)] if error.is_missing()), "{:?}", bank.check());
}
