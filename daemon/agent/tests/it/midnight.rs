//! Tests of runs without a limit. Such a run ends at midnight (UTC), when the next run begins.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use peernet_clock::{Clock, ClockIdentity, MonoTime, RawTime, SharedClock, Span, WallTime};

use crate::harness::{Aggregator, TestAgent, clock, config};

/// This machine's clock, shifted by a number of days.
#[derive(Debug)]
struct ShiftedClock {
    real: SharedClock,
    days: AtomicI64,
}

impl Clock for ShiftedClock {
    fn wall(&self) -> WallTime {
        self.real.wall() + Span::from_seconds(86_400 * self.days.load(Ordering::SeqCst))
    }

    fn mono(&self) -> MonoTime {
        self.real.mono()
    }

    fn raw(&self) -> RawTime {
        self.real.raw()
    }

    fn identity(&self) -> &ClockIdentity {
        self.real.identity()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn midnight_begins_run_without_warm_up() {
    let aggregator = Aggregator::start().await;
    let tables = "[[model]]\nname = 'echo'\nkind = 'echo'\n\
        [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', size_bytes = 1 }\n\
        placement = { kind = 'local', model = 'echo' }\nload = { mode = 'rate', hz = 100.0 }\n";
    let shifted_clock = Arc::new(ShiftedClock { real: clock("shifted_clock"), days: AtomicI64::new(0) });
    let clock = Arc::<ShiftedClock>::clone(&shifted_clock);
    let agent = TestAgent::start_on(clock, "edge", Some(&aggregator.address), config(tables)).await;
    aggregator.until(|received_events| received_events.iterations().len() >= 10).await;
    shifted_clock.days.fetch_add(1, Ordering::SeqCst);
    let received_events = aggregator
        .until(|received_events| {
            received_events.iterations().iter().filter(|it| it.number == 10).count() == 2
        })
        .await;
    let (runs, ended) = (received_events.run_starts(), received_events.run_ends());
    assert_eq!((runs.len(), ended.len()), (2, 1));
    assert_eq!((ended[0].run, ended[0].reason.as_str()), (runs[0].run, "finished"));
    assert!(ended[0].ended <= runs[1].started);
    // The default warm-up has five iterations.
    for (run, warm_up) in [(runs[0].run, 5), (runs[1].run, 0)] {
        let of_run =
            || received_events.iterations().into_iter().filter(move |iteration| iteration.run == run);
        assert!(of_run().map(|iteration| iteration.number).eq(1..=of_run().count() as u64));
        assert_eq!(of_run().filter(|iteration| iteration.warm_up).count(), warm_up);
    }
    agent.stop().await.expect("stops well");
}
