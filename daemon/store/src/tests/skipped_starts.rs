//! Counting of skipped starts. Iterations of every outcome report skipped starts.

use peernet_clock::Span;
use peernet_logger::{Measure, NodeId, RunId, Unit};
use peernet_stream::{Event, Iteration, Outcome};

use super::{NOW, TestStore, generate};
use crate::rebuild::rebuild;

/// Number of skipped starts that count in a run of [`TestStore::store_run_with_skipped_starts`]. Those before warm-up
/// iterations do not count.
pub(super) const SKIPPED: u64 = 3 + 4 + 5 + 6;

impl TestStore {
    /// Makes an iteration before which `skipped` starts were skipped.
    fn late_iteration(&self, run: RunId, number: u64, skipped: f64) -> Iteration {
        let mut iteration =
            generate::iteration(run, number, self.hosts(), &mut generate::Numbers::new(number));
        let measure = Measure::Value(skipped, Unit::NONE);
        iteration.tree.add(NodeId::ROOT, "skipped-starts".into(), Span::ZERO, measure);
        iteration
    }

    /// Stores a run with skipped starts before the warm-up and before iterations of every outcome, in three commits.
    pub(super) async fn store_run_with_skipped_starts(&mut self) -> RunId {
        let run = RunId::random();
        let mut warm_up = self.late_iteration(run, 1, 100.0);
        warm_up.warm_up = true;
        let mut timed_out_warm_up = self.late_iteration(run, 2, 50.0);
        (timed_out_warm_up.warm_up, timed_out_warm_up.outcome) = (true, Outcome::Timeout(String::new()));
        let outcomes = [
            Outcome::Ok,
            Outcome::Timeout(String::new()),
            Outcome::Failed("no".into()),
            Outcome::Lost("gone".into()),
        ];
        let later_events = (3..).zip(outcomes).map(|(number, outcome)| {
            Event::Iteration(Iteration { outcome, ..self.late_iteration(run, number, number as f64) })
        });
        let later_events: Vec<Event> = later_events.collect();
        let first = [warm_up, timed_out_warm_up].map(Event::Iteration);
        let work = self.batch([vec![generate::run_started(run, "line", NOW)], first.to_vec()].concat());
        self.commit(&[work]).await;
        for events in later_events.chunks(3) {
            let work = self.batch(events.to_vec());
            self.commit(&[work]).await;
        }
        run
    }

    pub(super) async fn skipped_starts(&self) -> Vec<u64> {
        let runs = self.store.runs(&crate::RunFilter::default()).await.expect("answers");
        runs.iter().rev().map(|run| run.skipped_starts).collect()
    }
}

#[tokio::test]
async fn skipped_starts_before_unanswered_iterations_count() {
    let mut test_store = TestStore::new().await;
    test_store.store_run_with_skipped_starts().await;
    test_store.store_run(5).await;
    assert_eq!(test_store.skipped_starts().await, [SKIPPED, 0]);
}

#[tokio::test]
async fn rebuild_counts_skipped_starts_again() {
    let mut test_store = TestStore::new().await;
    test_store.store_run_with_skipped_starts().await;
    test_store.store_run(5).await;
    let mut connection = test_store.second_connection().await;
    sqlx::query("UPDATE run SET skipped_starts = 7").execute(&mut connection).await.expect("spoils");
    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
    assert_eq!(test_store.skipped_starts().await, [SKIPPED, 0]);

    // If some iterations are deleted, a rebuild cannot count the skipped starts again and keeps their number.
    sqlx::query("INSERT INTO trimmed (run, kind, before_s) VALUES (1, 0, 9000000000)")
        .execute(&mut connection)
        .await
        .expect("trims");
    sqlx::query("DELETE FROM node WHERE run = 1").execute(&mut connection).await.expect("deletes");
    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
    assert_eq!(test_store.skipped_starts().await, [SKIPPED, 0]);
}

#[tokio::test]
async fn invalid_counts_of_skipped_starts_are_limited() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let invalid_counts = [f64::MAX, f64::MAX, f64::INFINITY, -5.0, f64::NAN, 2.0];
    for (number, skipped) in (1..).zip(invalid_counts) {
        let iteration = Event::Iteration(test_store.late_iteration(run, number, skipped));
        let work = test_store.batch(vec![iteration]);
        let committed = test_store.commit(&[work]).await;
        assert!(committed.quarantined.is_empty(), "{skipped}: {:?}", committed.quarantined);
    }
    // The writer limits the number of skipped starts of a run to 2^53.
    assert_eq!(test_store.skipped_starts().await, [1 << 53]);
    // A rebuild accepts the invalid counts, too.
    let mut connection = test_store.second_connection().await;
    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
}
