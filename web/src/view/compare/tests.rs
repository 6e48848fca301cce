use peernet_analysis::model_places::{ModelPlaces, PlacedModel};
use peernet_analysis::users::{EdgeMeasurements, Repeat};
use peernet_clock::{Span, Verdict};
use peernet_logger::{HostId, Name, RunId, stage};
use peernet_store::{DelayAccuracy, Episodes, MeanBucket, Series, SeriesPoint, StageMeans, StageSeries};
use peernet_stream::{EndReason, OutcomeCounts, Placement, PlacementKind};

use super::series::{RunTimeSeries, TimeSeriesByRun};
use super::*;
use crate::tests::samples::{self, HOSTILE};

/// Returns a run of 300 successful iterations, which ended after a minute.
pub(crate) fn run(number: i64, kind: PlacementKind) -> RunSummary {
    RunSummary {
        number,
        id: RunId::random(),
        host: HostId::random(),
        host_name: samples::slug("cam-1"),
        pipeline: samples::slug("line"),
        placement: Placement { ..samples::placement(kind) },
        started: samples::NOW,
        ended: Some(samples::NOW + Span::from_seconds(60)),
        reason: Some(EndReason::Finished),
        last_iteration: Some(samples::NOW + Span::from_seconds(59)),
        counts: OutcomeCounts { ok: 300, ..OutcomeCounts::default() },
        warm_up: 5,
        skipped_starts: 0,
        deadline_s: None,
        misses: None,
        actuator: Default::default(),
        total: Some(samples::figures(0.016, 300)),
        has_clock_fault: false,
        pinned: false,
        last_deleted_iteration: 0,
        experiment: None,
    }
}

/// Returns the statistics of stages, whose means are `scale` times the usual values, and of uploads of `bytes` bytes.
/// Also returns the accuracy of the delays.
pub(crate) fn stages(scale: f64, bytes: f64) -> (Vec<StageStatistics>, Vec<DelayAccuracy>) {
    let window = samples::window(60, 5.0, scale, Verdict::Ok);
    let stage = |(name, statistics): &(Name, QuantityStatistics)| StageStatistics {
        stage: name.clone(),
        unit: if name.ends_with("throughput") { "bit/s" } else { "s" }.to_owned(),
        is_stage: stage::ORDER.contains(name),
        statistics: *statistics,
        share: None,
        bound: None,
    };
    let mut all: Vec<StageStatistics> = window.values.iter().map(stage).collect();
    all.push(StageStatistics {
        stage: stage::UPLOAD_BYTES,
        unit: "B".to_owned(),
        is_stage: false,
        statistics: samples::figures(bytes, 300),
        share: None,
        bound: None,
    });
    (all, window.bounds)
}

/// Returns a configuration of one run. The configuration with index 0 has the name `A` and the run 1, index 1 has `B`
/// and 2, and so on. The means of the stages are `scale` times the usual values, and each upload has `bytes` bytes.
pub(crate) fn configuration(at: usize, kind: PlacementKind, scale: f64, bytes: f64) -> Configuration {
    let (stages, bounds) = stages(scale, bytes);
    let values = vec![format!("{} kB", bytes / 1e3), HOSTILE.to_owned()];
    let (mergeable, runs) = (mergeable(&stages), vec![run(at as i64 + 1, kind)]);
    let name = char::from(b'A' + at as u8).to_string();
    Configuration { name, values, runs, stages, bounds, mergeable, model_computes: true }
}

/// Returns the comparison of these configurations of an experiment.
pub(crate) fn comparison(configurations: Vec<Configuration>) -> Comparison {
    let axes = vec!["size".to_owned(), "where".to_owned()];
    let experiment = Some(("sizes".to_owned(), "a".to_owned()));
    let mergeable = |configuration: &Configuration| {
        configuration
            .runs
            .iter()
            .map(|run| (run.number, Arc::clone(&configuration.mergeable)))
            .collect::<Vec<_>>()
    };
    let statistics_by_run = configurations.iter().flat_map(mergeable).collect();
    let (settings, long_settings, left_out) = (Vec::new(), Vec::new(), Vec::new());
    Comparison {
        experiment,
        axes,
        settings,
        long_settings,
        total_column: total_column(&configurations),
        configurations,
        statistics_by_run,
        trust_by_run: HashMap::new(),
        replayed_by_run: HashMap::new(),
        unknown_labels_by_run: HashMap::new(),
        left_out,
        is_truncated: false,
    }
}

/// Returns stored statistics of 300 values of each stage, with the mean of the stage.
fn mergeable(stages: &[StageStatistics]) -> Arc<MergeableStatistics> {
    let mut mergeable = MergeableStatistics::default();
    for stage in stages {
        let mut values = Summary::default();
        // All messages of a configuration have one size.
        let spread = if stage.stage.ends_with("-bytes") { 0.0 } else { 0.2 };
        (0..300).for_each(|n| values.record(stage.statistics.mean * (1.0 + spread * f64::from(n).sin())));
        mergeable.add(stage.stage.clone(), &stage.unit, &values);
    }
    Arc::new(mergeable)
}

/// Returns the means of the total of a run, one for each bucket. The total varies by 1 % about `mean`.
pub(crate) fn total_in_buckets(mean: f64, buckets: usize) -> Vec<StageMeans> {
    let bucket = |at: usize| {
        let mut summary = Summary::default();
        (0..20).for_each(|n| summary.record(mean * (1.0 + 0.01 * ((at * 20 + n) as f64).sin())));
        let at = samples::NOW + Span::from_seconds(at as i64);
        MeanBucket { at, count: summary.count(), mean: summary.moments.mean }
    };
    let buckets = (0..buckets).map(bucket).collect();
    vec![StageMeans { stage: stage::TOTAL, buckets }]
}

/// Returns a minute of each run, with one point per second except for a gap. The minute has four episodes. The first
/// episode and one second of the third are warm-up. Three iterations of the run with the smallest number have no
/// answer.
pub(crate) fn run_time_series(comparison: &Comparison) -> TimeSeriesByRun {
    let first = comparison.runs().map(|run| run.number).min();
    let moment = |seconds: i64| samples::NOW + Span::from_seconds(seconds);
    let seconds = || (15..60_i64).filter(|second| !(30..33).contains(second));
    let series_of = |configuration: &Configuration, run: &RunSummary| {
        let mean = comparison.total(configuration)?.mean;
        let point = |second: i64| {
            let p50 = mean * (1.0 + 0.1 * (second as f64).sin());
            SeriesPoint { at: moment(second), count: 60, mean: p50, p50, p95: Some(p50 * 1.2) }
        };
        let means = configuration.stages.iter().filter(|stage| stage.unit == "s").map(|stage| StageMeans {
            stage: stage.stage.clone(),
            buckets: seconds()
                .map(|second| MeanBucket { at: moment(second), count: 60, mean: stage.statistics.mean })
                .collect(),
        });
        let total =
            StageSeries { stage: stage::TOTAL, unit: "s".to_owned(), points: seconds().map(point).collect() };
        let failed = if first == Some(run.number) { vec![31, 32, 50] } else { Vec::new() };
        let episodes = Episodes {
            first: Some(moment(0)),
            count: 4,
            steps: Some(900),
            borders: [15, 30, 45].map(moment).to_vec(),
            warm_up: vec![(moment(0), moment(15)), (moment(30), moment(31))],
            failed_in_warm_up: Some(0),
            failed_starts: failed.into_iter().map(moment).collect(),
        };
        let series = Series { bucket_s: 1, stages: vec![total], gaps: Vec::new() };
        Some((run.number, RunTimeSeries { series, means: means.collect(), episodes }))
    };
    comparison
        .configurations
        .iter()
        .flat_map(|one| one.runs.iter().filter_map(move |run| series_of(one, run)))
        .collect()
}

/// Returns the measurements of the users of the first repeat, who each got 300 answers in 59 s.
pub(crate) fn measured_users(comparison: &Comparison) -> users::MeasuredUsers {
    let edge = |configuration: &Configuration| {
        let totals = configuration.summary(&stage::TOTAL).cloned().unwrap_or_default();
        EdgeMeasurements { starts: 300, totals }
    };
    let repeats = |configuration: &Configuration| {
        let edges = configuration
            .runs
            .iter()
            .filter(|run| run.experiment.as_ref().is_none_or(|position| position.repeat == 0));
        vec![Repeat { common_seconds: Some(59.0), edges: edges.map(|_| edge(configuration)).collect() }]
    };
    let repeats = comparison.configurations.iter().map(repeats).collect();
    users::MeasuredUsers { repeats, resolution_s: 0 }
}

#[test]
fn query_selects_runs_or_an_experiment() {
    let parse = |pairs: &[(&str, &str)]| {
        let pairs: Vec<_> = pairs.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect();
        CompareSelection::parse(&pairs, "runs")
    };
    assert_eq!(parse(&[]).expect("valid parameters"), None);
    assert_eq!(
        parse(&[("runs", "3,#5, 3"), ("runs", "7")]).expect("valid parameters"),
        Some(CompareSelection::Runs(vec![3, 5, 7]))
    );
    assert_eq!(
        parse(&[("experiment", "x")]).expect("valid parameters"),
        Some(CompareSelection::Experiment("x".to_owned()))
    );
    for wrong in [&[("runs", "3,x")][..], &[("run", "3")], &[("runs", "3"), ("experiment", "x")]] {
        assert!(parse(wrong).is_err(), "{wrong:?}");
    }
    // A page compares at most 12 selected runs.
    let many = (1..=13).map(|n| n.to_string()).collect::<Vec<_>>().join(",");
    assert!(parse(&[("runs", &many)]).is_err());
}

/// Returns the means of the total over time, in `buckets` buckets, of the first run of each configuration.
pub(crate) fn totals(comparison: &Comparison, buckets: usize) -> RunMeans {
    let number_and_mean = |configuration: &Configuration| {
        configuration
            .runs
            .first()
            .zip(comparison.total(configuration))
            .map(|(run, total)| (run.number, total.mean))
    };
    let measured = comparison.configurations.iter().filter_map(number_and_mean);
    measured.map(|(run, mean)| (run, total_in_buckets(mean, buckets))).collect()
}

fn title_of(comparison: &Comparison, means: &RunMeans, baseline: usize) -> String {
    title(comparison, &Differences::of(comparison, means, baseline))
}

/// Returns the comparison of one configuration for each scale.
fn comparison_of_scales(scales: &[f64]) -> Comparison {
    let one = |(at, scale): (usize, &f64)| configuration(at, PlacementKind::Remote, *scale, 1e3);
    comparison(scales.iter().enumerate().map(one).collect())
}

#[test]
fn title_says_which_is_fastest_by_how_much() {
    let two = comparison_of_scales(&[1.5, 1.0]);
    let found = Differences::of(&two, &totals(&two, 20), 0);
    let total = found.total(1).expect("compared");
    assert_eq!((total.is_distinct(), found.others.len()), (Some(true), 1));
    let text = title(&two, &found);
    assert!(text.starts_with("B is the fastest: 16.0\u{202f}ms, 8.0"), "{text}");
    assert!(text.contains(" less than A (95\u{202f}%: "), "{text}");
    let (_, stages) = &found.others[0];
    let inference = stages.iter().find(|one| one.name == stage::INFERENCE).expect("compared");
    let difference = inference.mean_difference.expect("both means are known");
    assert_eq!(difference.interval, None, "`totals` gives no means of single stages over time");

    let three = comparison_of_scales(&[2.0, 1.0, 3.0]);
    let text = |baseline| title_of(&three, &totals(&three, 20), baseline);
    assert!(text(2).contains("ms less than C"), "{}", text(2));
    assert!(
        text(1).contains("ms less than A"),
        "a best baseline is compared with the next configuration: {}",
        text(1)
    );
}

#[test]
fn title_without_significant_difference_names_no_fastest() {
    let equal = comparison_of_scales(&[1.5, 1.5, 1.5, 1.5, 9.0]);
    let text = title_of(&equal, &totals(&equal, 20), 0);
    assert_eq!(text, "A and B, C and 1 more do not differ by more than chance");
    let short = comparison_of_scales(&[1.0, 1.5, 2.0]);
    let text = title_of(&short, &totals(&short, 3), 0);
    let expected = "A has the smallest mean of the 3 configurations, 16.0\u{202f}ms; too short for this page (needs 5\u{202f}s): peernet compare can tell";
    assert_eq!(text, expected);
    let mut failed_repeat = comparison_of_scales(&[1.0, 1.5, 2.0]);
    let failed = RunSummary { counts: OutcomeCounts::default(), ..run(9, PlacementKind::Remote) };
    failed_repeat.configurations[1].runs.push(failed);
    let text = title_of(&failed_repeat, &totals(&failed_repeat, 3), 0);
    assert_eq!(text, expected, "`peernet compare` ignores a run without a total, too");
    let few = comparison_of_scales(&[1.0, 1.5, 2.0]);
    // One bucket has 20 iterations.
    let text = title_of(&few, &totals(&few, 1), 0);
    assert!(
        text.ends_with("; too little is known to tell more"),
        "`peernet compare` has too few iterations, too: {text}"
    );
    assert!(title_of(&comparison(Vec::new()), &RunMeans::new(), 0).contains("has finished yet"));
}

#[test]
fn configuration_that_computes_nothing_is_not_ranked() {
    let mut all = comparison_of_scales(&[2.0, 1.0, 3.0]);
    all.configurations[1].model_computes = false;
    let text = |all: &Comparison| title_of(all, &totals(all, 20), 0);
    assert!(text(&all).starts_with("A is the fastest"), "{}", text(&all));
    let found = Differences::of(&all, &totals(&all, 20), 0);
    assert_eq!(
        found.total(1).and_then(StageDifference::is_distinct),
        Some(true),
        "a configuration without rank is compared with the baseline nevertheless"
    );
    all.configurations.iter_mut().for_each(|one| one.model_computes = false);
    assert!(
        text(&all).starts_with("B is the fastest"),
        "if no model computes, all configurations are ranked: {}",
        text(&all)
    );
}

#[test]
fn title_explains_why_one_configuration_is_ranked_alone() {
    let mut all = comparison_of_scales(&[2.0, 1.0]);
    all.configurations[1].model_computes = false;
    let means = totals(&all, 20);
    assert_eq!(title_of(&all, &means, 0), "Only A is ranked, because the model of B computes nothing");
    let found = Differences::of(&all, &means, None);
    assert_eq!((found.ranking, found.unranked, found.baseline), (None, vec![1], 0));
    let mut all = comparison_of_scales(&[2.0, 1.0, 3.0]);
    all.configurations[0].model_computes = false;
    all.configurations[1].model_computes = false;
    let text = title_of(&all, &totals(&all, 20), 0);
    assert_eq!(text, "Only C is ranked, because the models of A and B compute nothing");
}

#[test]
fn title_compares_only_measured_configurations() {
    let without = |failed: &[usize]| {
        let mut all = comparison_of_scales(&[1.0, 1.5, 2.0]);
        for at in failed {
            all.configurations[*at].stages.clear();
            all.configurations[*at].runs[0].counts.ok = 0;
        }
        title_of(&all, &totals(&all, 20), 0)
    };
    let text = "B has the smallest mean of the 3 configurations, 24.1\u{202f}ms; too little is known of A to tell more";
    assert_eq!(without(&[0]), text, "`peernet compare` has the same statement");
    assert_eq!(without(&[0, 2]), "Only B has measured anything: there is nothing to compare it with");
    assert_eq!(without(&[0, 1, 2]), "No successful iteration of these runs is stored yet");
}

#[test]
fn baseline_is_named_by_one_of_its_runs() {
    let two = comparison_of_scales(&[1.0, 2.0]);
    let index_of = |run| two.baseline(run).map_err(|error| error.to_string());
    assert_eq!(
        (index_of(None), index_of(Some("")), index_of(Some("2")), index_of(Some("#1"))),
        (Ok(None), Ok(None), Ok(Some(1)), Ok(Some(0)))
    );
    for wrong in ["3", "A"] {
        assert!(index_of(Some(wrong)).is_err_and(|text| text.contains("baseline") && text.contains(wrong)));
    }
}

#[test]
fn best_configuration_is_the_baseline_unless_one_is_chosen() {
    let three = comparison_of_scales(&[2.0, 1.0, 3.0]);
    let baseline = |chosen: Option<usize>| Differences::of(&three, &totals(&three, 20), chosen).baseline;
    assert_eq!([baseline(None), baseline(Some(0)), baseline(Some(2))], [1, 0, 2]);
    let without_buckets = Differences::of(&three, &RunMeans::new(), None);
    assert_eq!(without_buckets.baseline, 1, "means of whole runs rank without statistics over time");
}

#[test]
fn difference_after_deletion_equals_that_of_shown_means() {
    let two = comparison_of_scales(&[1.0, 2.0]);
    let mut means = totals(&two, 20);
    let complete = Differences::of(&two, &means, 0);
    // Retention deletes the first half of the statistics over time of run 2. The rest of this run was slower.
    for stage in means.get_mut(&2).expect("is compared") {
        stage.buckets.drain(..10);
        stage.buckets.iter_mut().for_each(|bucket| bucket.mean += 0.004);
    }
    let remaining = Differences::of(&two, &means, 0);
    for found in [&complete, &remaining, &Differences::of(&two, &RunMeans::new(), 0)] {
        let total = found.total(1).expect("compared");
        let (first, second) = (total.means.0.expect("measured"), total.means.1.expect("measured"));
        assert_eq!(total.mean_difference.expect("both are known").value, second - first);
        assert_eq!(found.ranking.as_ref().map(|ranking| ranking.best), Some(0));
    }
    assert!(remaining.total(1).and_then(|total| total.mean_difference?.interval).is_some());
}

#[test]
fn inference_of_model_is_compared_between_places() {
    let mixed = comparison(vec![
        configuration(0, PlacementKind::Remote, 1.0, 1e3),
        configuration(1, PlacementKind::Local, 2.0, 1e3),
        configuration(2, PlacementKind::Remote, 3.0, 1e6),
    ]);
    let (models, _) = models_by_place(&mixed);
    let names: Vec<&str> = models[0].places.iter().map(|place| place.configuration.as_str()).collect();
    assert_eq!(
        (models.len(), names),
        (1, vec!["B", "A + C"]),
        "both clouds are one place, as in the figure `paired`"
    );
    let mut many = configuration(1, PlacementKind::Remote, 1.0, 1e3);
    let run = many.runs.remove(0);
    for user in [10, 2, 1, 2] {
        many.runs.push(RunSummary { host_name: samples::slug(&format!("user-{user}")), ..run.clone() });
    }
    let users = comparison(vec![configuration(0, PlacementKind::Local, 1.0, 1e3), many]);
    let (several_users, _) = models_by_place(&users);
    assert!(
        several_users[0].places[1].place.starts_with("cloud: user-1, user-2, user-10 → "),
        "{}",
        several_users[0].places[1].place
    );
    let one_place = comparison((0..3).map(|at| configuration(at, PlacementKind::Remote, 1.0, 1e3)).collect());
    assert!(models_by_place(&one_place).0.is_empty());
}

#[test]
fn repeats_on_two_devices_are_two_places() {
    let mut cloud = configuration(1, PlacementKind::Remote, 1.0, 1e3);
    let first = cloud.runs.remove(0);
    for (number, device) in [(2, "cuda:0"), (3, "cuda:0"), (4, "cpu")] {
        let placement = Placement { device: Some(device.to_owned()), ..first.placement.clone() };
        cloud.runs.push(RunSummary { number, placement, ..first.clone() });
    }
    let mut repeats = comparison(vec![configuration(0, PlacementKind::Local, 1.0, 1e3), cloud]);
    repeats.statistics_by_run.insert(4, mergeable(&stages(4.0, 1e3).0));
    // The figure `paired` has the places of the runs, too.
    let placed = repeats.runs().map(|run| PlacedModel {
        model: run.placement.model.to_string(),
        kind: run.placement.kind.name().to_owned(),
        device: run.placement.device.clone().unwrap_or_default(),
    });
    let in_figure = ModelPlaces::new(&placed.collect::<Vec<_>>()).places;
    assert_eq!(in_figure, ["local", "cloud, cuda:0", "cloud, cpu"]);
    let (models, _) = models_by_place(&repeats);
    let places = models[0].places.iter().map(|row| row.place.split(": ").next().unwrap_or_default());
    assert_eq!(places.collect::<Vec<_>>(), in_figure);
    let configurations = models[0].places.iter().map(|row| row.configuration.as_str());
    assert_eq!(configurations.collect::<Vec<_>>(), ["A", "B", "B"]);
    let means: Vec<&str> = models[0].places.iter().map(|row| row.inference.0.as_str()).collect();
    assert!(means[0] == means[1] && means[1] != means[2], "{means:?}");
}
