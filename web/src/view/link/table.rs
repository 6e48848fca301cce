//! The time series of a link as a table, with the same numbers as its chart.

use peernet_clock::{Direction, Offset};
use peernet_statistics::BUCKET_WIDTHS_S;
use peernet_statistics::number::{NONE, bound_ms, count, offset_ms, trip_ms};
use peernet_store::ClockPoint;

use super::super::chip::Sign;
use super::delays::Delays;
use super::estimate_and_max_error;
use super::stats::ppm;
use super::time_series::LinkTimeSeries;
use crate::zone::{Zone, ZonedTime};

/// One time interval as a row; times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    pub at: ZonedTime,
    pub up: DelayCells,
    pub down: DelayCells,
    pub offset: String,
    pub bound: String,
    pub drift: String,
    /// Smallest round trip of probes.
    pub smallest: String,
    /// Median round trip of probes.
    pub median: String,
    /// Number of sent probes.
    pub sent: String,
    /// Number of lost probes.
    pub lost: String,
}

/// Delays of one direction.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DelayCells {
    pub value: String,
    pub interval: String,
    pub sign: Option<Sign>,
}

/// Approximate number of rows of a table.
const ROWS: f64 = 30.0;
/// Minimum time that a row covers, seconds.
const MIN_ROW_S: i64 = 10;

impl Row {
    /// Returns the rows of a time series, newest first.
    pub(crate) fn all(time_series: &LinkTimeSeries, zone: Zone) -> Vec<Self> {
        let approximate_seconds = ((time_series.seconds() / ROWS) as i64).max(MIN_ROW_S);
        let mut widths = BUCKET_WIDTHS_S.into_iter().map(i64::from);
        // A row must cover whole points, so its length is a multiple of the distance between points.
        let is_suitable = |width: &i64| *width >= approximate_seconds && *width % time_series.bucket == 0;
        let seconds = widths.find(is_suitable).unwrap_or(time_series.bucket);
        time_series.merged(seconds).points.iter().rev().map(|point| Self::of(point, zone)).collect()
    }

    /// Returns the delays of both directions, upload first.
    pub(crate) fn directions(&self) -> [&DelayCells; 2] {
        [&self.up, &self.down]
    }

    fn of(point: &ClockPoint, zone: Zone) -> Self {
        let dash = || NONE.to_owned();
        let offset = point.offset.as_ref();
        let estimate_and_error = offset.and_then(estimate_and_max_error);
        let trip = point.round_trip;
        Self {
            at: zone.moment(point.at),
            up: DelayCells::of(&Delays::of(Direction::Up, [point])),
            down: DelayCells::of(&Delays::of(Direction::Down, [point])),
            offset: estimate_and_error
                .map_or_else(dash, |(estimate, max_error)| offset_ms(estimate, max_error)),
            bound: estimate_and_error.map_or_else(dash, |(_, max_error)| bound_ms(max_error)),
            drift: offset.and_then(Offset::drift_ppm).map_or_else(dash, ppm),
            smallest: trip.map_or_else(dash, |trip| trip_ms(trip.min.seconds())),
            median: trip.map_or_else(dash, |trip| trip_ms(trip.median.seconds())),
            sent: count(point.probes.sent.into()),
            lost: count(point.probes.lost.into()),
        }
    }
}

impl DelayCells {
    fn of(delays: &Delays) -> Self {
        Self {
            value: delays.value(),
            interval: delays.interval().unwrap_or_default(),
            sign: delays.chip().map(Sign::from),
        }
    }
}
