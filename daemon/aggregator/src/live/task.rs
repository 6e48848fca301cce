//! The task that owns the live state and publishes its snapshots.

use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{SharedClock, Span};
use tokio::sync::{mpsc, watch};

use super::{LiveEvent, LiveTracker};
use crate::live_state::LiveState;

/// Shortest interval between two snapshots: at most five a second.
const SNAPSHOT_INTERVAL: Span = Span::from_millis(200);
/// Interval of applying the passing of time to silent hosts.
const EXPIRY_INTERVAL: Duration = Duration::from_secs(1);

/// Applies events until their channel is closed, and publishes a snapshot after changes.
pub(crate) async fn run(
    mut live: LiveTracker,
    mut events: mpsc::Receiver<LiveEvent>,
    snapshots: watch::Sender<Arc<LiveState>>,
    clock: SharedClock,
) {
    let mut expiry_interval = tokio::time::interval(EXPIRY_INTERVAL);
    expiry_interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut published_at = clock.mono();
    let mut changed = false;
    loop {
        // Events are collected until the next snapshot is due, so that a burst costs one snapshot.
        let wait = (SNAPSHOT_INTERVAL - (clock.mono() - published_at)).to_duration();
        tokio::select! {
            event = events.recv() => match event {
                Some(event) => changed |= live.apply(event, clock.stamp()),
                None => return,
            },
            _ = expiry_interval.tick() => changed |= live.expire(clock.stamp()),
            () = tokio::time::sleep(wait), if changed => {
                changed = false;
                published_at = clock.mono();
                snapshots.send_replace(live.shared_snapshot(clock.stamp()));
            }
        }
    }
}
