//! This host's clocks: the claims of its time daemon about the wall clock, steps of the wall clock, and interruptions
//! of the free-running clock.
//!
//! ```text
//! monitor      ten times a second: checks the clocks for steps, slews, sleeps and other disturbances
//! clocksource  hardware clock from which the kernel reads the time
//! vmclock      reports of the hypervisor about disruptions, if it provides them
//! sources      every few seconds: queries chronyc and the kernel; `claim` combines their answers
//! ```
//!
//! The difference of the boot clock and the monotonic clock changes only by sleeps; the difference of the wall clock
//! and the monotonic clock changes by steps and slews. Both differences are read with each stamp (`Clock::epoch`,
//! `Clock::wall_epoch`), so the next message detects a sleep or a step. Only slews, a changed clocksource and the
//! reports of the hypervisor have to be polled here.

mod chrony;
mod chronyc;
mod claim;
mod clocksource;
mod exact_claim;
mod kernel;
mod monitor;
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
use crate::config::{ClockConfig, ClockFaultConfig};
use crate::incidents::Incidents;
pub(crate) use clocksource::Clocksource;
use monitor::HostClockMonitor;
use sources::ClaimSources;
use vmclock::Vmclock;

/// Interval at which the clocks are checked.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);
/// Number of checks between two announcements of the difference of wall clock and free-running clock to peers.
const CHECKS_BETWEEN_ANNOUNCEMENTS: u32 = 100;
/// Number of checks between two such announcements while a time daemon claims an error bound of the wall clock.
// The number is smaller, because a peer widens the claim by the drift since the latest announcement.
const CHECKS_BETWEEN_ANNOUNCEMENTS_WITH_CLAIM: u32 = 10;

/// Returns the state of this host's clocks before any source was queried, in the form that peers receive.
pub(crate) fn initial_state(clock: &SharedClock) -> PeerClock {
    PeerClock {
        claim: None,
        text: "not queried yet".to_owned(),
        epoch: clock.wall_epoch(),
        faults: clock.injected_faults().cloned(),
        raw: Some(raw_clock(clock, Clocksource::from_sysfs(Path::new(InspectionSettings::SYSFS)).name())),
    }
}

/// Returns the description of a host's clocks for live updates.
pub(crate) fn describe_clock(clock: &PeerClock) -> HostClock {
    let PeerClock { epoch, claim, text, faults, raw } = clock.clone();
    let clocksource = raw.map(|raw| raw.clocksource).filter(|name| !name.is_empty());
    HostClock { claim, text, epoch, faults, clocksource }
}

fn raw_clock(clock: &SharedClock, clocksource: String) -> RawClock {
    // The epochs are read last. If a clock is disturbed in between, the new epoch voids the claims from before, which the
    // difference from after the disturbance must not convert.
    let wall_ahead = clock.wall_ahead();
    RawClock { epoch: clock.epoch(), wall_ahead, clocksource }
}

/// Monitors the host's clocks until `stop` is cancelled, and publishes their state, which begins with
/// [`initial_state`].
///
/// A new epoch is published within a tenth of a second, and earlier claims are void from then on. Claims are published
/// every `discipline_interval_s`, and once a second if clock fault injection makes them exact.
pub(crate) async fn run(
    config: ClockConfig,
    faults: Option<ClockFaultConfig>,
    clock: SharedClock,
    incidents: Incidents,
    publish: Sender<PeerClock>,
    stop: CancellationToken,
) {
    let clocksource = Clocksource::from_sysfs(Path::new(InspectionSettings::SYSFS));
    let vmclock = Vmclock::open_all(Path::new("/dev"));
    let mut monitor = HostClockMonitor::new(config.max_drift_ppm, clock.clone(), clocksource, vmclock);
    let check_loop = async {
        let mut ticks = interval(CHECK_INTERVAL);
        let mut checks = 0_u32;
        loop {
            ticks.tick().await;
            monitor.check(&incidents);
            checks = checks.wrapping_add(1);
            let (raw, wall_epoch) = (raw_clock(&clock, monitor.clocksource().to_owned()), clock.wall_epoch());
            publish.send_if_modified(|published| {
                let is_disturbed = published.epoch != wall_epoch
                    || published.raw.as_ref().is_none_or(|published| published.epoch != raw.epoch);
                if is_disturbed {
                    published.epoch = wall_epoch;
                    published.claim = None;
                    "not queried since the clock was disturbed".clone_into(&mut published.text);
                }
                let checks_between = if published.claim.is_some() {
                    CHECKS_BETWEEN_ANNOUNCEMENTS_WITH_CLAIM
                } else {
                    CHECKS_BETWEEN_ANNOUNCEMENTS
                };
                let is_due = checks.is_multiple_of(checks_between);
                // Each check updates the difference of the clocks, but most checks do not notify the receivers.
                published.raw = Some(raw);
                is_disturbed || is_due
            });
        }
    };
    let query_loop = async {
        let true_clock = Arc::new(SystemClock::new(clock.identity().clone()));
        let mut sources = ClaimSources::new(&config, faults.as_ref(), clock.clone(), true_clock);
        let mut ticks = interval(sources.interval());
        loop {
            ticks.tick().await;
            let epochs = (clock.wall_epoch(), clock.epoch());
            let summary = sources.query().await;
            let wall_ahead = clock.wall_ahead();
            // An answer from before a step says nothing about the clock after the step.
            if (clock.wall_epoch(), clock.epoch()) == epochs {
                publish.send_if_modified(|published| {
                    let (epoch, raw_epoch) = epochs;
                    let is_new = published.epoch != epoch
                        || published.claim != summary.claim
                        || published.text != summary.text;
                    published.epoch = epoch;
                    published.claim = summary.claim;
                    published.text = summary.text;
                    if let Some(raw) = &mut published.raw {
                        (raw.epoch, raw.wall_ahead) = (raw_epoch, wall_ahead);
                    }
                    is_new
                });
            }
        }
    };
    stop.run_until_cancelled(async { tokio::join!(check_loop, query_loop) }).await;
}

fn interval(period: Duration) -> tokio::time::Interval {
    let mut ticks = tokio::time::interval(period);
    // Ticks that were missed, for example while the host slept, are not made up for.
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}
