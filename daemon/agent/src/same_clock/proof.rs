//! Checks the answers of a cloud, and determines how long they are valid. No I/O: times are arguments.

use std::io;
use std::time::Duration;

use peernet_clock::{MonoTime, RawTime, Span};

use super::messages::{ClockAnswer, ClockQuery, Nonce};

/// Pause between two queries, except after a slow answer.
const QUERY_INTERVAL: Duration = Duration::from_secs(2);
/// Time for which a proof is valid after its answer.
const VALIDITY: Span = Span::from_seconds(5);
/// Longest round trip of an answer that is a proof. A different clock could differ by as much as the round trip.
const MAX_ROUND_TRIP: Span = Span::from_millis(5);
/// Maximum number of consecutive slow answers after which the next query is still sent at once.
const QUICK_RETRIES: u32 = 8;

/// Reason why it is not proven that both processes read one clock.
#[derive(Debug, thiserror::Error)]
pub(crate) enum NotProven {
    /// The two clocks cannot be one, or the cloud cannot reach the socket.
    #[error("the cloud has not connected to a clock socket of this process")]
    NotConnected,
    /// The connection ended.
    #[error("the connection to the cloud's process ended: {0}")]
    Ended(#[from] io::Error),
    /// The process at the other end of the connection does not serve the session.
    #[error("the connected process does not serve the session")]
    Foreign,
    /// The last proof has expired.
    #[error("the cloud's process has not answered in time")]
    Expired,
    /// The processes are in different time namespaces.
    #[error("the two processes are in different time namespaces")]
    TimeNamespace,
    /// This process does not read the kernel's time.
    #[error("a preloaded library shows this process other times than the kernel's")]
    OwnTime,
    /// The cloud's process does not read the kernel's time.
    #[error("a preloaded library shows the cloud's process other times than the kernel's")]
    PeerTime,
    /// The cloud's reading was not between two readings of this process.
    #[error("the cloud's free-running clock differs by {0} from the free-running clock of this process")]
    OtherClock(Span),
}

/// State of this process's clocks when an answer has arrived.
#[derive(Clone, Copy, Debug)]
pub(super) struct OwnClock {
    /// Reading of the free-running clock after the answer.
    pub(super) raw: RawTime,
    pub(super) mono: MonoTime,
    pub(super) shows_kernel_time: bool,
}

/// Result of checking an answer.
#[derive(Debug)]
pub(super) enum AnswerResult {
    /// Both processes read one clock.
    Proven,
    /// The answer took too long to prove anything.
    Slow,
    /// The processes do not read one clock.
    Refuted(NotProven),
    /// The process that answered does not serve the session.
    Foreign,
}

/// State of the proof for one session.
#[derive(Debug)]
pub(super) struct Proof {
    session: [u8; 16],
    time_namespace: u64,
    /// Nonce of the open query, and the reading of the free-running clock before it was sent.
    open_query: Option<(Nonce, RawTime)>,
    /// Number of consecutive answers that took too long.
    slow_answers: u32,
    /// Time of the last answer that was a proof.
    proven_at: Option<MonoTime>,
}

impl Proof {
    pub(super) const fn new(session: [u8; 16], time_namespace: u64) -> Self {
        Self { session, time_namespace, open_query: None, slow_answers: 0, proven_at: None }
    }

    /// Creates the next query, with a nonce that was never used before. `raw_before` is the reading of the
    /// free-running clock.
    pub(super) fn next_query(&mut self, nonce: Nonce, raw_before: RawTime) -> ClockQuery {
        self.open_query = Some((nonce, raw_before));
        ClockQuery { nonce }
    }

    /// Handles an answer; `answer` is `None` if the received bytes are not an answer.
    ///
    /// The session's id is random and sent over the session only. Therefore a process that knows this id is the other
    /// end of the session. The name of the socket is not secret on this machine (`/proc/net/unix`). The nonce prevents
    /// the replay of an old answer.
    pub(super) fn handle_answer(&mut self, answer: Option<ClockAnswer>, own_clock: OwnClock) -> AnswerResult {
        // Each query accepts one answer only: another answer with the same nonce proves nothing.
        let open_query = self.open_query.take();
        let (Some(answer), Some((nonce, raw_before))) = (answer, open_query) else {
            return self.reject_foreign();
        };
        if answer.session != self.session || answer.nonce != nonce {
            return self.reject_foreign();
        }
        if answer.time_namespace != self.time_namespace {
            return self.refute(NotProven::TimeNamespace);
        }
        // A preloaded library may show a process other times than the kernel's. Equal readings then do not prove one
        // clock.
        if !own_clock.shows_kernel_time {
            return self.refute(NotProven::OwnTime);
        }
        if !answer.shows_kernel_time {
            return self.refute(NotProven::PeerTime);
        }
        // The cloud read its clock after the query was sent and before the answer arrived. A reading outside that
        // interval is of a different clock.
        if answer.raw < raw_before {
            return self.refute(NotProven::OtherClock(answer.raw - raw_before));
        }
        if answer.raw > own_clock.raw {
            return self.refute(NotProven::OtherClock(answer.raw - own_clock.raw));
        }
        // A slow answer does not refute an earlier proof, which is valid until it expires.
        if own_clock.raw - raw_before > MAX_ROUND_TRIP {
            self.slow_answers = self.slow_answers.saturating_add(1);
            return AnswerResult::Slow;
        }
        (self.slow_answers, self.proven_at) = (0, Some(own_clock.mono));
        AnswerResult::Proven
    }

    /// Returns the pause before the next query.
    pub(super) const fn pause(&self) -> Duration {
        // After a slow answer the next answer is probably fast. After many slow answers the machine is busy, and more
        // queries would add to its load.
        if self.slow_answers == 0 || self.slow_answers > QUICK_RETRIES {
            QUERY_INTERVAL
        } else {
            Duration::ZERO
        }
    }

    /// Returns for how long the proof is valid without another answer; `None` without a proof.
    pub(super) fn valid_for(&self, now: MonoTime) -> Option<Span> {
        Some((self.proven_at? + VALIDITY - now).max(Span::ZERO))
    }

    /// Ends the proof if it has expired. Returns whether it has expired.
    pub(super) fn expire(&mut self, now: MonoTime) -> bool {
        let has_expired = self.valid_for(now) == Some(Span::ZERO);
        if has_expired {
            self.proven_at = None;
        }
        has_expired
    }

    /// Ends the proof, because the processes do not read one clock.
    fn refute(&mut self, reason: NotProven) -> AnswerResult {
        (self.slow_answers, self.proven_at) = (0, None);
        AnswerResult::Refuted(reason)
    }

    /// Ends the proof, because the answer is not from the process that serves the session.
    fn reject_foreign(&mut self) -> AnswerResult {
        self.proven_at = None;
        AnswerResult::Foreign
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SESSION: [u8; 16] = [7; 16];
    const NAMESPACE: u64 = 4_026_531_834;

    fn raw(micros: i64) -> RawTime {
        RawTime::from_nanos(micros * 1_000)
    }

    fn mono(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(seconds * 1_000_000_000)
    }

    fn own(micros: i64, seconds: i64) -> OwnClock {
        OwnClock { raw: raw(micros), mono: mono(seconds), shows_kernel_time: true }
    }

    /// Returns an answer that proves the common clock: read 20 µs after the query at 100 µs.
    fn proving_answer(nonce: Nonce) -> ClockAnswer {
        ClockAnswer {
            nonce,
            session: SESSION,
            time_namespace: NAMESPACE,
            shows_kernel_time: true,
            raw: raw(120),
        }
    }

    /// Returns a proof with a query at 100 µs.
    fn proof_with_open_query() -> Proof {
        let mut proof = Proof::new(SESSION, NAMESPACE);
        proof.next_query([1; 16], raw(100));
        proof
    }

    #[test]
    fn proof_holds_for_five_seconds() {
        let mut proof = proof_with_open_query();
        assert_eq!(proof.valid_for(mono(0)), None);
        assert!(matches!(
            proof.handle_answer(Some(proving_answer([1; 16])), own(140, 10)),
            AnswerResult::Proven
        ));
        assert_eq!(proof.valid_for(mono(12)), Some(Span::from_seconds(3)));
        assert!(!proof.expire(mono(14)));
        assert!(proof.expire(mono(15)) && !proof.expire(mono(16)), "the expiry is reported once");
        assert_eq!(proof.valid_for(mono(16)), None);
    }

    #[test]
    fn each_contradiction_refutes_and_ends_earlier_proof() {
        let answers: [(ClockAnswer, OwnClock, &str); 5] = [
            (ClockAnswer { time_namespace: 1, ..proving_answer([2; 16]) }, own(140, 12), "time namespaces"),
            (
                ClockAnswer { shows_kernel_time: false, ..proving_answer([2; 16]) },
                own(140, 12),
                "the cloud's process other",
            ),
            (
                proving_answer([2; 16]),
                OwnClock { shows_kernel_time: false, ..own(140, 12) },
                "this process other",
            ),
            (ClockAnswer { raw: raw(99), ..proving_answer([2; 16]) }, own(140, 12), "differs by"),
            (ClockAnswer { raw: raw(141), ..proving_answer([2; 16]) }, own(140, 12), "differs by"),
        ];
        for (answer, own_clock, words) in answers {
            let mut proof = proof_with_open_query();
            assert!(matches!(
                proof.handle_answer(Some(proving_answer([1; 16])), own(140, 10)),
                AnswerResult::Proven
            ));
            proof.next_query([2; 16], raw(100));
            let AnswerResult::Refuted(reason) = proof.handle_answer(Some(answer), own_clock) else {
                panic!("{words}")
            };
            assert!(reason.to_string().contains(words), "{reason}");
            assert_eq!(proof.valid_for(mono(12)), None);
        }
    }

    #[test]
    fn slow_answer_keeps_proof_and_causes_quick_retries() {
        let mut proof = proof_with_open_query();
        assert!(matches!(
            proof.handle_answer(Some(proving_answer([1; 16])), own(140, 10)),
            AnswerResult::Proven
        ));
        for retry in 1..=QUICK_RETRIES + 1 {
            proof.next_query([2; 16], raw(100));
            assert!(matches!(
                proof.handle_answer(Some(proving_answer([2; 16])), own(5_101, 12)),
                AnswerResult::Slow
            ));
            assert_eq!(proof.pause() == Duration::ZERO, retry <= QUICK_RETRIES);
        }
        assert_eq!(proof.valid_for(mono(13)), Some(Span::from_seconds(2)));
        assert!(proof.expire(mono(15)));
    }

    #[test]
    fn unsolicited_or_repeated_answer_is_foreign() {
        let mut proof = proof_with_open_query();
        assert!(matches!(
            proof.handle_answer(Some(proving_answer([1; 16])), own(140, 10)),
            AnswerResult::Proven
        ));
        assert!(
            matches!(proof.handle_answer(Some(proving_answer([1; 16])), own(140, 10)), AnswerResult::Foreign),
            "the answer is a replay"
        );
        let mut proof = proof_with_open_query();
        assert!(matches!(proof.handle_answer(None, own(140, 10)), AnswerResult::Foreign));
    }

    proptest! {
        #[test]
        fn same_clock_is_proved_only_by_cloud_of_session(
            nonce in prop_oneof![Just([1; 16]), any::<Nonce>()],
            session in prop_oneof![Just(SESSION), any::<[u8; 16]>()],
            time_namespace in prop_oneof![Just(NAMESPACE), any::<u64>()],
            (cloud_shows_kernel_time, own_shows_kernel_time) in any::<(bool, bool)>(),
            offset_us in prop_oneof![Just(0i64), -100_000i64..100_000],
            (there_us, back_us) in (0i64..4_000, 0i64..4_000),
        ) {
            let mut proof = proof_with_open_query();
            let answer = ClockAnswer {
                nonce, session, time_namespace,
                shows_kernel_time: cloud_shows_kernel_time,
                raw: raw(100 + there_us + offset_us),
            };
            let own_clock = OwnClock {
                shows_kernel_time: own_shows_kernel_time,
                ..own(100 + there_us + back_us, 10)
            };
            let both_show_kernel_time = cloud_shows_kernel_time && own_shows_kernel_time;
            let result = proof.handle_answer(Some(answer), own_clock);
            let is_proven = matches!(result, AnswerResult::Proven);
            prop_assert_eq!(is_proven, proof.valid_for(mono(10)).is_some());
            let is_cloud = nonce == [1; 16] && session == SESSION;
            prop_assert_eq!(is_cloud, !matches!(result, AnswerResult::Foreign));
            if is_proven {
                prop_assert!(is_cloud && time_namespace == NAMESPACE && both_show_kernel_time);
                prop_assert!(offset_us.abs() <= MAX_ROUND_TRIP.nanos() / 1_000);
            } else if is_cloud && time_namespace == NAMESPACE && both_show_kernel_time && offset_us == 0 {
                prop_assert!(there_us + back_us > 5_000, "a true proof was refused: {result:?}");
            }
        }

        #[test]
        fn messages_read_back_as_written(
            nonce: Nonce, session: [u8; 16], time_namespace: u64, shows_kernel_time: bool, nanos: i64,
        ) {
            let query = ClockQuery { nonce };
            prop_assert_eq!(ClockQuery::from_bytes(&query.to_bytes()), Some(query));
            let raw = RawTime::from_nanos(nanos);
            let answer = ClockAnswer { nonce, session, time_namespace, shows_kernel_time, raw };
            prop_assert_eq!(ClockAnswer::from_bytes(&answer.to_bytes()), Some(answer));
        }

        #[test]
        fn other_bytes_are_refused(bytes: [u8; 32], more: [u8; 25]) {
            let mut answer = [0; ClockAnswer::BYTES];
            answer[..32].copy_from_slice(&bytes);
            answer[32..].copy_from_slice(&more);
            prop_assert_eq!(ClockAnswer::from_bytes(&answer), None);
            let mut query = [0; ClockQuery::BYTES];
            query.copy_from_slice(&bytes[..ClockQuery::BYTES]);
            prop_assert_eq!(ClockQuery::from_bytes(&query), None);
        }
    }
}
