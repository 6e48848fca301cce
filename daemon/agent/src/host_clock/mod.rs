//! This host's own wall clock: what its time daemon claims, and whether it was stepped, ran off or slept.
//!
//! ```text
//! watch     ten times a second: is the wall clock still going as it should?
//! sources   every few seconds: chronyc and kernel are asked, claim merges what they say
//! ```

mod chrony;
mod chronyc;
mod claim;
mod kernel;
mod rehearsed;
mod sources;
#[cfg(test)]
mod tests;
mod timex;
mod watch;

use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{SharedClock, SystemClock};
use peernet_stream::HostClock;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use crate::config::{ClockConfig, RehearsalConfig};
use crate::incidents::Incidents;
use sources::Sources;
use watch::Watchman;

/// How often the clock is looked at.
const LOOK: Duration = Duration::from_millis(100);

/// What is known of the clock before anybody was asked.
pub(crate) fn not_asked_yet(clock: &SharedClock) -> HostClock {
    HostClock {
        discipline: None,
        text: "not asked yet".to_owned(),
        epoch: clock.wall_epoch(),
        rehearsal: clock.rehearsal().cloned(),
    }
}

/// Watches over the clock until it is told to stop. What is known goes to `publish`, which begins with
/// [`not_asked_yet`]: a new epoch within a tenth of a second, with it the end of all claims; claims every
/// `discipline_interval_s`, and once a second where a rehearsal makes them exact.
pub(crate) async fn run(
    config: ClockConfig,
    rehearsal: Option<RehearsalConfig>,
    clock: SharedClock,
    incidents: Incidents,
    publish: tokio::sync::watch::Sender<HostClock>,
    stop: CancellationToken,
) {
    let mut watchman = Watchman::new(config.max_drift_ppm, clock.clone());
    let looking = async {
        let mut ticks = interval(LOOK);
        loop {
            ticks.tick().await;
            watchman.look(&incidents);
            let epoch = clock.wall_epoch();
            publish.send_if_modified(|known| {
                let new = known.epoch != epoch;
                if new {
                    known.epoch = epoch;
                    known.discipline = None;
                    "the clock was disturbed, not asked since".clone_into(&mut known.text);
                }
                new
            });
        }
    };
    let asking = async {
        let truth = Arc::new(SystemClock::new(clock.identity().clone()));
        let mut sources = Sources::new(&config, rehearsal.as_ref(), clock.clone(), truth);
        let mut ticks = interval(sources.period());
        loop {
            ticks.tick().await;
            let before = clock.wall_epoch();
            let summary = sources.ask().await;
            // What was said before a step is void.
            if clock.wall_epoch() == before {
                publish.send_if_modified(|known| {
                    let new = known.epoch != before
                        || known.discipline != summary.discipline
                        || known.text != summary.text;
                    known.epoch = before;
                    known.discipline = summary.discipline;
                    known.text = summary.text;
                    new
                });
            }
        }
    };
    stop.run_until_cancelled(async { tokio::join!(looking, asking) }).await;
}

fn interval(period: Duration) -> tokio::time::Interval {
    let mut ticks = tokio::time::interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}
