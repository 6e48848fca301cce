//! Timeouts and limits of a session.

mod ros2;

pub use ros2::Ros2SessionSettings;

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Largest allowed value of every time: one day. Milliseconds.
const MAX_TIME_MS: u64 = 24 * 3600 * 1000;

/// Largest allowed value of `max_in_flight`. The queues of the transports have room for `max_in_flight` messages and a
/// few more, so this value also bounds the queues.
pub const MAX_IN_FLIGHT: u32 = 4_096;

/// Largest allowed value of `max_in_flight_bytes` and `max_unfinished_bytes`: 1 TiB.
const MAX_IN_FLIGHT_BYTES: u64 = 1 << 40;

/// Largest allowed value of `max_sessions`.
const MAX_SESSIONS: u32 = 65_536;

// Smallest and largest values of keys. `max_in_flight` and `max_sessions` begin at 1 and end at the constants above.
const TIME_RANGE_FROM_1_MS: (u64, u64) = (1, MAX_TIME_MS);
const TIME_RANGE_FROM_10_MS: (u64, u64) = (10, MAX_TIME_MS);
const CLOSE_TIMEOUT_MS_RANGE: (u64, u64) = (0, MAX_TIME_MS);
const IN_FLIGHT_BYTES_RANGE: (u64, u64) = (4 << 10, MAX_IN_FLIGHT_BYTES);
const UNFINISHED_BYTES_RANGE: (u64, u64) = (64 << 10, MAX_IN_FLIGHT_BYTES);
// libzmq neither sends nor receives longer datagrams (`MAX_UDP_MSG`).
const DATAGRAM_BYTES_RANGE: (u64, u64) = (512, 8_192);
const SOCKET_BUFFER_BYTES_RANGE: (u64, u64) = (64 << 10, 1 << 30);

/// Timeouts and limits of a session. Each end has separate settings; if a limit concerns both ends, the smaller value
/// applies.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SessionSettings {
    /// Time limit for opening a session, including the loading of the model on the cloud. Milliseconds.
    pub open_timeout_ms: u64,
    /// Time after which a listener closes a connection that has neither a session nor asked for one. Milliseconds.
    pub hello_timeout_ms: u64,
    /// Interval at which a silent peer is asked for a heartbeat. Milliseconds.
    pub heartbeat_interval_ms: u64,
    /// Time after which a peer counts as gone if it is silent or does not acknowledge our bytes. Milliseconds.
    pub heartbeat_timeout_ms: u64,
    /// Time limit for sending the last answers and the goodbye when a session or a port closes. Milliseconds.
    pub close_timeout_ms: u64,
    /// Largest message that is accepted, all frames together. Bytes.
    pub max_message_bytes: u64,
    /// Maximum number of requests of one session in flight. The edge delays further requests; the cloud answers them as
    /// overloaded.
    pub max_in_flight: u32,
    /// Maximum number of bytes of the requests in flight of all sessions of a listener. Requests count from their
    /// arrival until they are answered. Further requests are answered as overloaded. While no other request is in
    /// flight, a larger request is accepted, too; `max_message_bytes` limits its size.
    pub max_in_flight_bytes: u64,
    /// Maximum number of bytes of unfinished messages of all sessions of a listener. A message is unfinished until it
    /// has arrived completely. A connection whose message would exceed this limit is closed. While no other message is
    /// unfinished, a message of any allowed size is accepted. A connection without a session may have 64 KiB of
    /// unfinished messages.
    pub max_unfinished_bytes: u64,
    /// Maximum number of sessions of a listener. One host may have at most half of the sessions that other hosts do not
    /// use.
    pub max_sessions: u32,
    /// Largest datagram that is sent, without the headers of UDP and IP. Bytes. For networks over datagrams only.
    pub datagram_bytes: u64,
    /// Rate at which datagrams are sent; 0 adapts the rate to what the other end receives. Bits per second. For
    /// networks over datagrams only.
    pub max_send_bits_per_second: u64,
    /// Time that the receiver waits for the missing fragments of a message once it knows that all fragments were sent.
    /// Milliseconds. For networks over datagrams only.
    pub reassembly_timeout_ms: u64,
    /// Size of the system's buffers of each socket. Bytes. For networks over datagrams and for ROS 2.
    pub socket_buffer_bytes: u64,
    /// Settings of topics of ROS 2.
    pub ros2: Ros2SessionSettings,
}

impl Default for SessionSettings {
    fn default() -> Self {
        Self {
            open_timeout_ms: 30_000,
            hello_timeout_ms: 5_000,
            heartbeat_interval_ms: 1_000,
            heartbeat_timeout_ms: 5_000,
            close_timeout_ms: 2_000,
            max_message_bytes: 64 * 1024 * 1024,
            max_in_flight: 64,
            max_in_flight_bytes: 512 * 1024 * 1024,
            max_unfinished_bytes: 128 * 1024 * 1024,
            max_sessions: 256,
            // With the headers of UDP and IP, the datagram fits into IPv6's minimum MTU, 1,280 bytes (RFC 8200, section
            // 5).
            datagram_bytes: 1_200,
            max_send_bits_per_second: 0,
            reassembly_timeout_ms: 100,
            socket_buffer_bytes: 4 * 1024 * 1024,
            ros2: Ros2SessionSettings::default(),
        }
    }
}

/// Error: the value of a setting is not allowed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key} = {value}: {problem}")]
pub struct InvalidSettings {
    /// Key in the configuration.
    pub key: &'static str,
    /// Configured value.
    pub value: u64,
    /// Reason why the value is not allowed.
    pub problem: String,
}

fn check_range(key: &'static str, value: u64, (min, max): (u64, u64)) -> Result<(), InvalidSettings> {
    if (min..=max).contains(&value) {
        return Ok(());
    }
    Err(InvalidSettings { key, value, problem: format!("must be between {min} and {max}") })
}

impl SessionSettings {
    /// Smallest and largest value of `max_message_bytes`.
    pub const MESSAGE_BYTES_RANGE: (u64, u64) = (4 << 10, 4 << 30);

    /// Checks the ranges of all values.
    ///
    /// # Errors
    /// If a value is out of range, or the heartbeat timeout is shorter than two heartbeat intervals. The error names
    /// the key and what is allowed.
    pub fn check(&self) -> Result<(), InvalidSettings> {
        check_range("open_timeout_ms", self.open_timeout_ms, TIME_RANGE_FROM_1_MS)?;
        check_range("hello_timeout_ms", self.hello_timeout_ms, TIME_RANGE_FROM_10_MS)?;
        check_range("heartbeat_interval_ms", self.heartbeat_interval_ms, TIME_RANGE_FROM_10_MS)?;
        check_range("heartbeat_timeout_ms", self.heartbeat_timeout_ms, TIME_RANGE_FROM_10_MS)?;
        check_range("close_timeout_ms", self.close_timeout_ms, CLOSE_TIMEOUT_MS_RANGE)?;
        check_range("max_message_bytes", self.max_message_bytes, Self::MESSAGE_BYTES_RANGE)?;
        check_range("max_in_flight", u64::from(self.max_in_flight), (1, u64::from(MAX_IN_FLIGHT)))?;
        check_range("max_in_flight_bytes", self.max_in_flight_bytes, IN_FLIGHT_BYTES_RANGE)?;
        check_range("max_unfinished_bytes", self.max_unfinished_bytes, UNFINISHED_BYTES_RANGE)?;
        check_range("max_sessions", u64::from(self.max_sessions), (1, u64::from(MAX_SESSIONS)))?;
        check_range("datagram_bytes", self.datagram_bytes, DATAGRAM_BYTES_RANGE)?;
        check_range("reassembly_timeout_ms", self.reassembly_timeout_ms, TIME_RANGE_FROM_10_MS)?;
        check_range("socket_buffer_bytes", self.socket_buffer_bytes, SOCKET_BUFFER_BYTES_RANGE)?;
        self.ros2.check()?;
        // With a shorter timeout, a single late heartbeat would end the connection.
        if self.heartbeat_timeout_ms < self.heartbeat_interval_ms.saturating_mul(2) {
            return Err(InvalidSettings {
                key: "heartbeat_timeout_ms",
                value: self.heartbeat_timeout_ms,
                problem: format!(
                    "must be at least twice heartbeat_interval_ms, {}",
                    self.heartbeat_interval_ms
                ),
            });
        }
        Ok(())
    }

    /// Returns the settings with every value brought into the range that [`check`](Self::check) allows.
    pub(crate) fn clamped(self) -> Self {
        let clamped = |value: u64, (min, max): (u64, u64)| value.clamp(min, max);
        // The interval is at most half of the longest time, so that twice the interval is an allowed timeout.
        let heartbeat_interval_ms =
            clamped(self.heartbeat_interval_ms, (TIME_RANGE_FROM_10_MS.0, TIME_RANGE_FROM_10_MS.1 / 2));
        Self {
            open_timeout_ms: clamped(self.open_timeout_ms, TIME_RANGE_FROM_1_MS),
            hello_timeout_ms: clamped(self.hello_timeout_ms, TIME_RANGE_FROM_10_MS),
            heartbeat_interval_ms,
            heartbeat_timeout_ms: clamped(
                self.heartbeat_timeout_ms,
                (2 * heartbeat_interval_ms, TIME_RANGE_FROM_10_MS.1),
            ),
            close_timeout_ms: clamped(self.close_timeout_ms, CLOSE_TIMEOUT_MS_RANGE),
            max_message_bytes: clamped(self.max_message_bytes, Self::MESSAGE_BYTES_RANGE),
            max_in_flight: self.max_in_flight.clamp(1, MAX_IN_FLIGHT),
            max_in_flight_bytes: clamped(self.max_in_flight_bytes, IN_FLIGHT_BYTES_RANGE),
            max_unfinished_bytes: clamped(self.max_unfinished_bytes, UNFINISHED_BYTES_RANGE),
            max_sessions: self.max_sessions.clamp(1, MAX_SESSIONS),
            datagram_bytes: clamped(self.datagram_bytes, DATAGRAM_BYTES_RANGE),
            max_send_bits_per_second: self.max_send_bits_per_second,
            reassembly_timeout_ms: clamped(self.reassembly_timeout_ms, TIME_RANGE_FROM_10_MS),
            socket_buffer_bytes: clamped(self.socket_buffer_bytes, SOCKET_BUFFER_BYTES_RANGE),
            ros2: self.ros2.clamped(),
        }
    }

    pub(crate) const fn open_timeout(&self) -> Duration {
        Duration::from_millis(self.open_timeout_ms)
    }

    pub(crate) const fn hello_timeout(&self) -> Duration {
        Duration::from_millis(self.hello_timeout_ms)
    }

    pub(crate) const fn heartbeat_interval(&self) -> Duration {
        Duration::from_millis(self.heartbeat_interval_ms)
    }

    pub(crate) const fn heartbeat_timeout(&self) -> Duration {
        Duration::from_millis(self.heartbeat_timeout_ms)
    }

    pub(crate) const fn reassembly_timeout(&self) -> Duration {
        Duration::from_millis(self.reassembly_timeout_ms)
    }

    pub(crate) const fn close_timeout(&self) -> Duration {
        Duration::from_millis(self.close_timeout_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_names_invalid_key_and_defaults_are_valid() {
        let with = |change: fn(&mut SessionSettings)| {
            let mut settings = SessionSettings::default();
            change(&mut settings);
            settings
        };
        assert_eq!(SessionSettings::default().check(), Ok(()));
        assert_eq!(SessionSettings::default().clamped(), SessionSettings::default());
        for (settings, key) in [
            (with(|s| s.max_in_flight = 0), "max_in_flight"),
            (with(|s| s.max_in_flight = u32::MAX), "max_in_flight"),
            (with(|s| s.open_timeout_ms = 0), "open_timeout_ms"),
            (with(|s| s.heartbeat_interval_ms = 0), "heartbeat_interval_ms"),
            (with(|s| s.heartbeat_timeout_ms = u64::MAX), "heartbeat_timeout_ms"),
            (with(|s| s.heartbeat_timeout_ms = s.heartbeat_interval_ms), "heartbeat_timeout_ms"),
            (with(|s| s.max_message_bytes = 1), "max_message_bytes"),
            (with(|s| s.max_in_flight_bytes = 0), "max_in_flight_bytes"),
            (with(|s| s.max_in_flight_bytes = u64::MAX), "max_in_flight_bytes"),
            (with(|s| s.hello_timeout_ms = 0), "hello_timeout_ms"),
            (with(|s| s.max_unfinished_bytes = 0), "max_unfinished_bytes"),
            (with(|s| s.max_sessions = 0), "max_sessions"),
            (with(|s| s.datagram_bytes = 9_000), "datagram_bytes"),
            (with(|s| s.reassembly_timeout_ms = 0), "reassembly_timeout_ms"),
            (with(|s| s.socket_buffer_bytes = 0), "socket_buffer_bytes"),
            (with(|s| s.ros2.depth = 0), "ros2.depth"),
            (with(|s| s.ros2.deadline_ms = Some(0)), "ros2.deadline_ms"),
        ] {
            assert_eq!(settings.check().expect_err(key).key, key);
            assert_eq!(settings.clamped().check(), Ok(()), "{key}");
        }
    }
}
