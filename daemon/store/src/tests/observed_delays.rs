//! Delays of an observed ROS system. The sizes of its messages are unknown. Pages and `data.csv` judge these delays
//! alike.

use peernet_analysis::rows::{Row, Rows};
use peernet_analysis::trust::TrustInput;
use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict};
use peernet_logger::{Measure, NodeId, RunId, Transit, Tree, stage};
use peernet_stream::{Event, Iteration};

use super::{NOW, TestStore, generate};

const COUNT: u64 = 20;

impl TestStore {
    /// Makes an iteration with the nodes that the agent writes for a pair of messages with stamps of the peer. The
    /// delays of the first eight iterations are unknown, because a clock was stepped. The upload of iteration 12 is
    /// negative.
    fn observed_iteration(&self, run: RunId, number: u64) -> Iteration {
        let mut iteration =
            generate::iteration(run, number, self.hosts(), &mut generate::Numbers::new(number));
        let anchor = iteration.tree.anchors()[0].clone();
        let sent = anchor.wall;
        let mut tree = Tree::new(stage::ITERATION, anchor);
        let millis = |millis: i64| Span::from_millis(millis);
        let timer = |span: Span| Measure::Timer(Some(span));
        let transit = |value: Span| {
            let raw = value + millis(5_000);
            let bounds = Interval { lo: value - millis(2), hi: value + millis(1) };
            let limited = OneWayDelay {
                value: Some(value),
                bounds: Some(bounds),
                verdict: Verdict::Limited,
                ..OneWayDelay::stepped(raw, DelaySource::InBand)
            };
            let delay = if number <= 8 { OneWayDelay::stepped(raw, DelaySource::InBand) } else { limited };
            Measure::Transit(Box::new(Transit {
                sent,
                received: Some(sent + raw),
                delay: Some(delay),
                raw_stamps: None,
            }))
        };
        let up = millis(if number == 12 { -3 } else { 20 });
        for (name, measure) in [
            (stage::UPLOAD, transit(up)),
            (stage::INFERENCE, timer(millis(30))),
            (stage::DOWNLOAD, transit(millis(5))),
            (stage::TOTAL, timer(millis(56))),
        ] {
            tree.add(NodeId::ROOT, name, Span::ZERO, measure);
        }
        iteration.tree = tree;
        iteration
    }
}

#[tokio::test]
async fn observed_delays_have_equal_verdicts_in_rows_and_store() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let iterations: Vec<Iteration> =
        (1..=COUNT).map(|number| test_store.observed_iteration(run, number)).collect();
    let rows: Rows = iterations.iter().map(Row::from_iteration).collect();
    let started = std::iter::once(generate::run_started(run, "line", NOW));
    let work = test_store.batch(started.chain(iterations.into_iter().map(Event::Iteration)).collect());
    test_store.commit(&[work]).await;
    let detail = test_store.store.run(1).await.expect("answers").expect("is stored");
    let stored = test_store.store.trust_input(&detail).await.expect("answers");

    let from_rows = TrustInput::from_rows(&rows, &[]);
    let verdicts = |input: &TrustInput| -> Vec<_> {
        input.clocks.iter().map(|clocks| (clocks.stage.clone(), clocks.verdicts.clone())).collect()
    };
    assert_eq!(verdicts(&from_rows), verdicts(&stored));
    assert_eq!(from_rows.clocks.len(), 2);
    for (rows, stored) in from_rows.clocks.iter().zip(&stored.clocks) {
        let near = |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| (a / b - 1.0).abs() < 0.01);
        assert!(near(rows.delay, stored.delay), "{rows:?} {stored:?}");
        // A finding names both ends of the interval. They must agree with the tables of summaries.
        let [of_rows, of_store] = [rows, stored].map(|clocks| clocks.interval.expect("all have bounds"));
        let ends = [(of_rows.lo, of_store.lo), (of_rows.hi, of_store.hi)];
        assert!(ends.iter().all(|(a, b)| near(Some(*a), Some(*b))), "{rows:?} {stored:?}");
        assert_eq!(of_rows.method, of_store.method);
    }
    // An unknown delay counts as the mean of the known delays, not as zero.
    assert_eq!(from_rows.split.parts.len(), stored.split.parts.len());
    for ((name, seconds), (stored_name, stored_seconds)) in
        from_rows.split.parts.iter().zip(&stored.split.parts)
    {
        assert_eq!(name, stored_name);
        assert!((seconds - stored_seconds).abs() < 1e-9, "{name}: {seconds} {stored_seconds}");
    }
    let (_, upload) = &from_rows.split.parts[0];
    assert!((upload - (11.0 * 0.020 - 0.003) / 12.0).abs() < 1e-9, "{:?}", from_rows.split);
}
