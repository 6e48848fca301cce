//! This host's own clocks: what its time daemon claims of the wall clock, whether it was stepped or ran off, and whether the
//! free-running clock was interrupted.
//!
//! ```text
//! watch        ten times a second: do the clocks still go as they should?
//! clocksource  what the kernel reads them from
//! vmclock      what the hypervisor says of that, where it says something
//! sources      every few seconds: chronyc and kernel are asked, claim merges what they say
//! ```

mod chrony;
mod chronyc;
mod claim;
mod clocksource;
mod kernel;
mod monitor;
mod rehearsed;
mod sources;
#[cfg(test)]
mod tests;
mod timex;
mod vmclock;

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{SharedClock, SystemClock};
use peernet_networks::{PeerClock, RawClock};
use peernet_stream::HostClock;
use tokio::sync::watch::Sender;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use crate::conditions::InspectionSettings;
use crate::config::{ClockConfig, RehearsalConfig};
use crate::incidents::Incidents;
pub(crate) use clocksource::Clocksource;
use monitor::HostClockMonitor;
use sources::Sources;
use vmclock::Vmclock;

/// How often the clocks are looked at.
const LOOK: Duration = Duration::from_millis(100);
/// After so many looks peers are told anew how far the wall clock is ahead of the free-running one.
const LOOKS_BETWEEN_NEWS: u32 = 100;
/// The same where something is claimed about the wall clock, which is of use only with that.
const LOOKS_BETWEEN_CLAIMS: u32 = 10;

/// What is known of the clocks before anybody was asked.
pub(crate) fn not_asked_yet(clock: &SharedClock) -> PeerClock {
    PeerClock {
        discipline: None,
        text: "not asked yet".to_owned(),
        epoch: clock.wall_epoch(),
        rehearsal: clock.rehearsal().cloned(),
        raw: Some(raw_clock(clock, Clocksource::below(Path::new(InspectionSettings::SYSFS)).name())),
    }
}

/// Returns what is shown of the clocks of a host.
pub(crate) fn shown(clock: &PeerClock) -> HostClock {
    let PeerClock { epoch, discipline, text, rehearsal, raw } = clock.clone();
    let clocksource = raw.map(|raw| raw.clocksource).filter(|name| !name.is_empty());
    HostClock { discipline, text, epoch, rehearsal, clocksource }
}

fn raw_clock(clock: &SharedClock, clocksource: String) -> RawClock {
    RawClock { epoch: clock.epoch(), wall_ahead: clock.wall_ahead(), clocksource }
}

/// Monitors the host's clocks until `stop` is cancelled, and publishes their state, which begins with [`not_asked_yet`].
///
/// A new epoch is published within a tenth of a second and ends all claims. Claims are published every
/// `discipline_interval_s`, and once a second where a rehearsal makes them exact.
pub(crate) async fn run(
    config: ClockConfig,
    rehearsal: Option<RehearsalConfig>,
    clock: SharedClock,
    incidents: Incidents,
    publish: Sender<PeerClock>,
    stop: CancellationToken,
) {
    let clocksource = Clocksource::below(Path::new(InspectionSettings::SYSFS));
    let vmclock = Vmclock::below(Path::new("/dev"));
    let mut monitor = HostClockMonitor::new(config.max_drift_ppm, clock.clone(), clocksource, vmclock);
    let looking = async {
        let mut ticks = interval(LOOK);
        let mut looks = 0_u32;
        loop {
            ticks.tick().await;
            monitor.look(&incidents);
            looks = looks.wrapping_add(1);
            let (wall_epoch, raw) = (clock.wall_epoch(), raw_clock(&clock, monitor.clocksource().to_owned()));
            publish.send_if_modified(|known| {
                let is_disturbed = known.epoch != wall_epoch
                    || known.raw.as_ref().is_none_or(|known| known.epoch != raw.epoch);
                if is_disturbed {
                    known.epoch = wall_epoch;
                    known.discipline = None;
                    "the clock was disturbed, not asked since".clone_into(&mut known.text);
                }
                let between =
                    if known.discipline.is_some() { LOOKS_BETWEEN_CLAIMS } else { LOOKS_BETWEEN_NEWS };
                let is_due = looks.is_multiple_of(between);
                known.raw = Some(raw);
                is_disturbed || is_due
            });
        }
    };
    let asking = async {
        let truth = Arc::new(SystemClock::new(clock.identity().clone()));
        let mut sources = Sources::new(&config, rehearsal.as_ref(), clock.clone(), truth);
        let mut ticks = interval(sources.period());
        loop {
            ticks.tick().await;
            let before = (clock.wall_epoch(), clock.epoch());
            let summary = sources.ask().await;
            // What was said before a step is void.
            if (clock.wall_epoch(), clock.epoch()) == before {
                publish.send_if_modified(|known| {
                    let (epoch, raw_epoch) = before;
                    let new = known.epoch != epoch
                        || known.discipline != summary.discipline
                        || known.text != summary.text;
                    known.epoch = epoch;
                    known.discipline = summary.discipline;
                    known.text = summary.text;
                    if let Some(raw) = &mut known.raw {
                        (raw.epoch, raw.wall_ahead) = (raw_epoch, clock.wall_ahead());
                    }
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
