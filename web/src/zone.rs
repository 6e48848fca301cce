//! Conversion of times to the time zone of the pages.

use std::fmt;
use std::str::FromStr;

use chrono::{DateTime, FixedOffset, Local, Offset, TimeZone, Utc};
use peernet_clock::WallTime;
use serde::{Deserialize, Serialize};

/// The time zone in which pages show times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Zone {
    /// The zone of the machine that serves the pages, summer time included.
    #[default]
    Local,
    /// Coordinated universal time.
    Utc,
    /// A fixed offset from UTC, in seconds east.
    Fixed(i32),
}

/// A text that is not a time zone.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a time zone: use \"local\", \"utc\" or an offset such as \"+01:00\"")]
pub struct InvalidZone(String);

impl Zone {
    fn at(self, time: WallTime) -> DateTime<FixedOffset> {
        let utc = Utc.timestamp_nanos(time.unix_nanos());
        let offset = match self {
            Self::Local => Local.offset_from_utc_datetime(&utc.naive_utc()).fix(),
            Self::Utc => Utc.fix(),
            Self::Fixed(seconds) => FixedOffset::east_opt(seconds).unwrap_or_else(|| Utc.fix()),
        };
        utc.with_timezone(&offset)
    }

    /// Returns the offset from UTC at a time, in seconds east.
    pub(crate) fn offset_seconds(self, time: WallTime) -> i32 {
        self.at(time).offset().local_minus_utc()
    }

    /// Returns the zone's name at a time: `UTC`, `UTC+1`, `UTC−3:30`.
    pub(crate) fn name(self, time: WallTime) -> String {
        let seconds = self.offset_seconds(time);
        let (sign, minutes) = (if seconds < 0 { '\u{2212}' } else { '+' }, seconds.unsigned_abs() / 60);
        match (minutes / 60, minutes % 60) {
            (0, 0) => "UTC".to_owned(),
            (hours, 0) => format!("UTC{sign}{hours}"),
            (hours, minutes) => format!("UTC{sign}{hours}:{minutes:02}"),
        }
    }

    /// Converts a time to this zone.
    pub(crate) fn moment(self, time: WallTime) -> ZonedTime {
        ZonedTime(self.at(time))
    }

    /// Formats a time range. A range within one day contains the date once: `19 Nov 2026, 13:41:07 – 13:51:07`.
    pub(crate) fn range(self, from: WallTime, to: WallTime) -> String {
        let (from, to) = (self.moment(from), self.moment(to));
        if from.date() == to.date() {
            format!("{}, {} – {}", from.date(), from.time_of_day(), to.time_of_day())
        } else {
            format!("{}, {} – {}, {}", from.date(), from.time_of_day(), to.date(), to.time_of_day())
        }
    }
}

impl FromStr for Zone {
    type Err = InvalidZone;
    fn from_str(text: &str) -> Result<Self, InvalidZone> {
        match text {
            "local" => Ok(Self::Local),
            "utc" => Ok(Self::Utc),
            offset => offset
                .parse::<FixedOffset>()
                .map(|offset| Self::Fixed(offset.local_minus_utc()))
                .map_err(|_| InvalidZone(text.to_owned())),
        }
    }
}

impl TryFrom<String> for Zone {
    type Error = InvalidZone;
    fn try_from(text: String) -> Result<Self, InvalidZone> {
        text.parse()
    }
}

impl From<Zone> for String {
    fn from(zone: Zone) -> Self {
        match zone {
            Zone::Local => "local".to_owned(),
            Zone::Utc => "utc".to_owned(),
            Zone::Fixed(seconds) => {
                // A parsed offset is always valid; only a `Fixed` of other code can be outside ±24 h.
                FixedOffset::east_opt(seconds).map_or_else(|| "utc".to_owned(), |offset| offset.to_string())
            }
        }
    }
}

/// A time in a zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ZonedTime(DateTime<FixedOffset>);

impl ZonedTime {
    /// Returns the time of day with seconds: `14:11:02`.
    pub(crate) fn time_of_day(&self) -> String {
        self.0.format("%H:%M:%S").to_string()
    }

    /// Returns the label of a mark on a time axis: the time of day without seconds (`14:11`), and the day at midnight
    /// (`19 Nov`).
    pub(crate) fn axis_label(&self) -> String {
        let is_midnight = self.0.time() == chrono::NaiveTime::MIN;
        self.0.format(if is_midnight { "%-d %b" } else { "%H:%M" }).to_string()
    }

    /// Returns the time of day with milliseconds: `13:46:56.400`.
    pub(crate) fn time_with_milliseconds(&self) -> String {
        self.0.format("%H:%M:%S%.3f").to_string()
    }

    /// Returns the date: `19 Nov 2026`.
    pub(crate) fn date(&self) -> String {
        self.0.format("%-d %b %Y").to_string()
    }
}

impl fmt::Display for ZonedTime {
    /// Writes the time as the `datetime` attribute of HTML needs it (RFC 3339).
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let utc_as_z = true;
        f.write_str(&self.0.to_rfc3339_opts(chrono::SecondsFormat::Millis, utc_as_z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIME: WallTime = WallTime::from_unix_nanos(1_795_089_667_400_000_000);

    #[test]
    fn time_is_formatted_in_its_zone() {
        let zone: Zone = "+01:00".parse().expect("an offset");
        let moment = zone.moment(TIME);
        assert_eq!(moment.date(), "19 Nov 2026");
        assert_eq!(moment.time_of_day(), "13:01:07");
        assert_eq!(moment.time_with_milliseconds(), "13:01:07.400");
        assert_eq!(moment.to_string(), "2026-11-19T13:01:07.400+01:00");
        assert_eq!(zone.name(TIME), "UTC+1");
        assert_eq!(Zone::Utc.name(TIME), "UTC");
        assert_eq!(Zone::Fixed(-12_600).name(TIME), "UTC\u{2212}3:30");
    }

    #[test]
    fn mark_at_midnight_is_labelled_with_the_day() {
        let zone: Zone = "+01:00".parse().expect("an offset");
        assert_eq!(zone.moment(TIME).axis_label(), "13:01");
        let midnight = WallTime::from_unix_nanos(1_795_129_200_000_000_000);
        assert_eq!(zone.moment(midnight).axis_label(), "20 Nov");
    }

    #[test]
    fn range_within_a_day_names_the_date_once() {
        let later = TIME + peernet_clock::Span::from_seconds(600);
        assert_eq!(Zone::Utc.range(TIME, later), "19 Nov 2026, 12:01:07 – 12:11:07");
        let tomorrow = TIME + peernet_clock::Span::from_seconds(86_400);
        assert_eq!(Zone::Utc.range(TIME, tomorrow), "19 Nov 2026, 12:01:07 – 20 Nov 2026, 12:01:07");
    }

    #[test]
    fn zone_keeps_its_text_and_invalid_text_is_refused() {
        for text in ["local", "utc", "+01:00", "-03:30"] {
            assert_eq!(String::from(text.parse::<Zone>().expect("a zone")), text);
        }
        assert!("Mars/Olympus".parse::<Zone>().expect_err("no zone").to_string().contains("Mars/Olympus"));
    }

    #[test]
    fn extreme_times_do_not_panic() {
        for nanos in [i64::MIN, i64::MAX] {
            assert!(!Zone::Fixed(3_600).moment(WallTime::from_unix_nanos(nanos)).time_of_day().is_empty());
        }
    }
}
