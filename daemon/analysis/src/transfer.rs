//! Bytes that iterations sent, and the time for which their messages were in transit.
//!
//! This module alone defines *speed while sending* and *traffic*, for live windows and stored runs. The throughput of a
//! single iteration is a node. The mean of these throughputs is not a speed, because small messages would count as much
//! as large messages.

use peernet_clock::{Direction, Verdict};
use peernet_logger::{Name, stage};
use serde::Serialize;

/// Names of the nodes that describe the messages of one direction.
#[derive(Debug)]
pub struct DirectionNodes {
    /// One-way delay of the message.
    pub delay: Name,
    /// Bytes of the payload.
    pub payload: Name,
    /// Bytes of the metadata.
    pub metadata: Name,
    /// Bits of payload and metadata per second of the delay.
    pub throughput: Name,
}

impl DirectionNodes {
    /// Returns the names of a direction.
    pub fn of(direction: Direction) -> &'static Self {
        static UP: DirectionNodes = DirectionNodes {
            delay: stage::UPLOAD,
            payload: stage::UPLOAD_BYTES,
            metadata: stage::UPLOAD_LOGGER_BYTES,
            throughput: stage::UPLOAD_THROUGHPUT,
        };
        static DOWN: DirectionNodes = DirectionNodes {
            delay: stage::DOWNLOAD,
            payload: stage::DOWNLOAD_BYTES,
            metadata: stage::DOWNLOAD_LOGGER_BYTES,
            throughput: stage::DOWNLOAD_THROUGHPUT,
        };
        match direction {
            Direction::Up => &UP,
            Direction::Down => &DOWN,
        }
    }

    /// Returns the names of both directions, in the order of [`Direction::ALL`].
    pub fn both() -> [&'static Self; 2] {
        Direction::ALL.map(Self::of)
    }
}

/// Returns the direction whose delay has this name; `None` if the name is not that of a delay.
pub fn direction_of_delay(name: &Name) -> Option<Direction> {
    Direction::ALL.into_iter().find(|direction| DirectionNodes::of(*direction).delay == *name)
}

/// Sums over the messages of successful iterations in one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Transfer {
    /// Bytes of all messages, payload and metadata.
    pub bytes: f64,
    /// Estimated bytes of the messages whose one-way delay is known: these messages are assumed to have the average
    /// size.
    pub timed_bytes: f64,
    /// Sum of the known one-way delays, seconds.
    pub seconds: f64,
}

impl Transfer {
    /// Returns the sums of a direction; `None` if nothing was sent in this direction. `statistics` returns the number
    /// of values of a node and their mean, in the SI unit of the node.
    pub fn from_statistics(
        direction: Direction,
        statistics: impl Fn(&Name) -> Option<(u64, f64)>,
    ) -> Option<Self> {
        let DirectionNodes { delay, payload, metadata, .. } = DirectionNodes::of(direction);
        let (messages, mean) = statistics(payload)?;
        let sum = |(count, mean): (u64, f64)| count as f64 * mean;
        let bytes = sum((messages, mean)) + statistics(metadata).map_or(0.0, sum);
        let (timed_messages, seconds) = statistics(delay).map_or((0, 0.0), |delay| (delay.0, sum(delay)));
        // The size of every message is known, but the delay of some messages is not. The messages with a known delay
        // are assumed to have the average size.
        let timed_share = (timed_messages as f64 / messages.max(1) as f64).min(1.0);
        Some(Self { bytes, timed_bytes: bytes * timed_share, seconds })
    }

    /// Returns the speed while sending in bits per second: the size of the messages with a known delay, divided by the
    /// sum of these delays. `None` while no delay is known.
    pub fn speed(&self) -> Option<f64> {
        (self.seconds > 0.0 && self.timed_bytes > 0.0).then(|| 8.0 * self.timed_bytes / self.seconds)
    }

    /// Returns the speed while sending if the clocks determine it; `verdict` is the verdict on the delays, `None` if no
    /// delay was judged. `None` while no delay is known, or if the verdict is neither `ok` nor `limited`.
    pub fn known_speed(&self, verdict: Option<Verdict>) -> Option<KnownSpeed> {
        let is_interval_only = is_speed_interval_only(verdict)?;
        Some(KnownSpeed { bits_per_second: self.speed()?, is_interval_only })
    }

    /// Returns the traffic in bits per second: bytes divided by `wall_s` seconds of wall time. `None` if `wall_s` is 0.
    pub fn traffic(&self, wall_s: f64) -> Option<f64> {
        (wall_s > 0.0).then(|| 8.0 * self.bytes / wall_s)
    }
}

/// Speed while sending that the clocks determine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownSpeed {
    /// The speed, from the estimated delays.
    pub bits_per_second: f64,
    /// `true` if only an interval of the speed is known, because the verdict on the delays is `limited`. The speed is
    /// then to be shown as an interval, not as a number.
    pub is_interval_only: bool,
}

/// Sums of both directions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Transfers {
    /// Sums from the edge to the cloud; `None` if nothing was sent.
    pub up: Option<Transfer>,
    /// Sums from the cloud to the edge; `None` if nothing was sent.
    pub down: Option<Transfer>,
}

impl Transfers {
    /// Returns the sums of both directions. `statistics` is the same function as for [`Transfer::from_statistics`].
    pub fn from_statistics(statistics: impl Fn(&Name) -> Option<(u64, f64)>) -> Self {
        Self {
            up: Transfer::from_statistics(Direction::Up, &statistics),
            down: Transfer::from_statistics(Direction::Down, &statistics),
        }
    }

    /// Returns the sums of a direction; `None` if nothing was sent in this direction.
    pub const fn of(&self, direction: Direction) -> Option<Transfer> {
        match direction {
            Direction::Up => self.up,
            Direction::Down => self.down,
        }
    }
}

/// Returns whether only an interval of a speed is known, because the verdict on the delays is `limited`. `verdict` is
/// `None` if no delay was judged. Returns `None` if the speed is unknown, because the verdict is neither `ok` nor
/// `limited`.
pub const fn is_speed_interval_only(verdict: Option<Verdict>) -> Option<bool> {
    match verdict {
        // Results of other programs have delays without verdicts.
        None | Some(Verdict::Ok) => Some(false),
        Some(Verdict::Limited) => Some(true),
        Some(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A small, fast message and a large, slow message, each as (bytes, seconds).
    const MESSAGES: [(f64, f64); 2] = [(2e3, 1e-6), (122e3, 3.58e-3)];

    fn means(name: &Name) -> Option<(u64, f64)> {
        let mean = |quantity: fn((f64, f64)) -> f64| MESSAGES.map(quantity).iter().sum::<f64>() / 2.0;
        match name.as_str() {
            "upload-bytes" => Some((2, mean(|(bytes, _)| bytes))),
            "upload" => Some((2, mean(|(_, seconds)| seconds))),
            _ => None,
        }
    }

    #[test]
    fn speed_is_total_bytes_per_total_transfer_time() {
        let Transfers { up, down } = Transfers::from_statistics(means);
        let up = up.expect("something was sent");
        let speed = up.speed().expect("delays are known") / 8e6;
        assert!(
            (speed - 34.63).abs() < 0.01,
            "{speed} MB/s; the mean of the speeds of both messages is 1,017"
        );
        assert!((up.traffic(10.0).expect("ten seconds") / 8e6 - 0.0124).abs() < 1e-9);
        assert_eq!((down, up.traffic(0.0)), (None, None));
    }

    #[test]
    fn verdict_decides_whether_speed_is_known() {
        let up = Transfer { bytes: 2e6, timed_bytes: 1e6, seconds: 0.5 };
        let known = |is_interval_only| Some(KnownSpeed { bits_per_second: 16e6, is_interval_only });
        assert_eq!([None, Some(Verdict::Ok)].map(|verdict| up.known_speed(verdict)), [known(false); 2]);
        assert_eq!(up.known_speed(Some(Verdict::Limited)), known(true));
        for verdict in [Verdict::Stale, Verdict::Unsynchronised, Verdict::Stepped, Verdict::Inconsistent] {
            assert_eq!(up.known_speed(Some(verdict)), None, "{verdict:?}");
        }
        let without_delays = Transfer { timed_bytes: 0.0, seconds: 0.0, ..up };
        assert_eq!(without_delays.known_speed(Some(Verdict::Ok)), None);
    }

    #[test]
    fn messages_without_known_delay_count_as_traffic_only() {
        let statistics = |name: &Name| match name.as_str() {
            "download-bytes" => Some((10, 1_000.0)),
            "download-logger-bytes" => Some((10, 200.0)),
            "download" => Some((4, 0.001)),
            _ => None,
        };
        let down = Transfer::from_statistics(Direction::Down, statistics).expect("something was sent");
        assert_eq!((down.bytes, down.timed_bytes, down.seconds), (12_000.0, 4_800.0, 0.004));
        let without_delays = |name: &Name| statistics(name).filter(|_| name.as_str() != "download");
        assert_eq!(
            Transfer::from_statistics(Direction::Down, without_delays).and_then(|down| down.speed()),
            None
        );
    }
}
