//! Judges the answers of a cloud: what they prove, and for how long. No I/O: times are arguments.

use std::io;
use std::time::Duration;

use peernet_clock::{MonoTime, RawTime, Span};

use super::messages::{Answer, Nonce, Question};

/// Pause between two questions while answers prove it.
const QUESTION_INTERVAL: Duration = Duration::from_secs(2);
/// Time that a proof holds after its answer.
const VALIDITY: Span = Span::from_seconds(5);
/// Longest round trip of an answer that proves something. Within it another clock could differ by as much.
const MAX_ROUND_TRIP: Span = Span::from_millis(5);
/// Number of slow answers in a row after each of which the next question follows at once.
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
    #[error("the process that connected is not the one that serves the session")]
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
    #[error("the cloud's free-running clock is {0} off what this process reads")]
    OtherClock(Span),
}

/// State of this process's own clocks when an answer has arrived.
#[derive(Clone, Copy, Debug)]
pub(super) struct OwnClock {
    /// Reading of the free-running clock after the answer.
    pub(super) raw: RawTime,
    pub(super) mono: MonoTime,
    pub(super) shows_kernel_time: bool,
}

/// Result of an answer.
#[derive(Debug)]
pub(super) enum Outcome {
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
    /// Nonce of the open question, and the reading of the free-running clock before it was sent.
    open_question: Option<(Nonce, RawTime)>,
    /// Number of answers in a row that took too long.
    slow: u32,
    /// Time of the last answer that proved it.
    proven: Option<MonoTime>,
}

impl Proof {
    pub(super) const fn new(session: [u8; 16], time_namespace: u64) -> Self {
        Self { session, time_namespace, open_question: None, slow: 0, proven: None }
    }

    /// Creates the next question, with a nonce that was never used before; `before` is the reading of the
    /// free-running clock.
    pub(super) fn ask(&mut self, nonce: Nonce, before: RawTime) -> Question {
        self.open_question = Some((nonce, before));
        Question { nonce }
    }

    /// Handles an answer; `None` if the received bytes are not an answer.
    ///
    /// The session's id is random and sent over the session only, so that whoever knows it is the process at its
    /// other end. The name of the socket is not a secret among the processes of this machine (`/proc/net/unix`). The
    /// nonce prevents the replay of an old answer.
    pub(super) fn answered(&mut self, answer: Option<Answer>, own: OwnClock) -> Outcome {
        // A question counts for one answer only: a second answer with the same nonce proves nothing.
        let open_question = self.open_question.take();
        let (Some(answer), Some((nonce, before))) = (answer, open_question) else { return self.foreign() };
        if answer.session != self.session || answer.nonce != nonce {
            return self.foreign();
        }
        if answer.time_namespace != self.time_namespace {
            return self.refuted(NotProven::TimeNamespace);
        }
        // A preloaded library may show a process other times than the kernel's. Then readings that agree do not mean
        // one clock.
        if !own.shows_kernel_time {
            return self.refuted(NotProven::OwnTime);
        }
        if !answer.shows_kernel_time {
            return self.refuted(NotProven::PeerTime);
        }
        // The cloud read its clock after the question was sent and before the answer arrived. A reading outside that
        // interval is one of another clock.
        if answer.raw < before {
            return self.refuted(NotProven::OtherClock(answer.raw - before));
        }
        if answer.raw > own.raw {
            return self.refuted(NotProven::OtherClock(answer.raw - own.raw));
        }
        // A slow answer contradicts nothing, so that an earlier proof holds until it expires.
        if own.raw - before > MAX_ROUND_TRIP {
            self.slow = self.slow.saturating_add(1);
            return Outcome::Slow;
        }
        (self.slow, self.proven) = (0, Some(own.mono));
        Outcome::Proven
    }

    /// Returns the time to wait before the next question.
    pub(super) const fn pause(&self) -> Duration {
        // After a slow answer the next one is probably fast. After many the machine is busy, and more questions would
        // add to its load.
        if self.slow == 0 || self.slow > QUICK_RETRIES { QUESTION_INTERVAL } else { Duration::ZERO }
    }

    /// Returns how long the proof holds without another answer; `None` without a proof.
    pub(super) fn holds_for(&self, now: MonoTime) -> Option<Span> {
        Some((self.proven? + VALIDITY - now).max(Span::ZERO))
    }

    /// Ends the proof if it has expired. Returns whether it has.
    pub(super) fn expire(&mut self, now: MonoTime) -> bool {
        let is_over = self.holds_for(now) == Some(Span::ZERO);
        if is_over {
            self.proven = None;
        }
        is_over
    }

    fn refuted(&mut self, why: NotProven) -> Outcome {
        (self.slow, self.proven) = (0, None);
        Outcome::Refuted(why)
    }

    fn foreign(&mut self) -> Outcome {
        self.proven = None;
        Outcome::Foreign
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

    /// Returns an answer that proves it, read 20 µs after the question at 100 µs.
    fn good(nonce: Nonce) -> Answer {
        Answer { nonce, session: SESSION, time_namespace: NAMESPACE, shows_kernel_time: true, raw: raw(120) }
    }

    /// Returns a proof with a question at 100 µs.
    fn proof_with_open_question() -> Proof {
        let mut proof = Proof::new(SESSION, NAMESPACE);
        proof.ask([1; 16], raw(100));
        proof
    }

    #[test]
    fn proof_holds_for_five_seconds() {
        let mut proof = proof_with_open_question();
        assert_eq!(proof.holds_for(mono(0)), None);
        assert!(matches!(proof.answered(Some(good([1; 16])), own(140, 10)), Outcome::Proven));
        assert_eq!(proof.holds_for(mono(12)), Some(Span::from_seconds(3)));
        assert!(!proof.expire(mono(14)));
        assert!(proof.expire(mono(15)) && !proof.expire(mono(16)), "told once");
        assert_eq!(proof.holds_for(mono(16)), None);
    }

    #[test]
    fn each_contradiction_refutes_and_ends_earlier_proof() {
        let answers: [(Answer, OwnClock, &str); 5] = [
            (Answer { time_namespace: 1, ..good([2; 16]) }, own(140, 12), "time namespaces"),
            (Answer { shows_kernel_time: false, ..good([2; 16]) }, own(140, 12), "the cloud's process other"),
            (good([2; 16]), OwnClock { shows_kernel_time: false, ..own(140, 12) }, "this process other"),
            (Answer { raw: raw(99), ..good([2; 16]) }, own(140, 12), "off what"),
            (Answer { raw: raw(141), ..good([2; 16]) }, own(140, 12), "off what"),
        ];
        for (answer, own_clock, words) in answers {
            let mut proof = proof_with_open_question();
            assert!(matches!(proof.answered(Some(good([1; 16])), own(140, 10)), Outcome::Proven));
            proof.ask([2; 16], raw(100));
            let Outcome::Refuted(why) = proof.answered(Some(answer), own_clock) else { panic!("{words}") };
            assert!(why.to_string().contains(words), "{why}");
            assert_eq!(proof.holds_for(mono(12)), None);
        }
    }

    #[test]
    fn slow_answer_keeps_proof_until_it_expires_and_is_asked_again() {
        let mut proof = proof_with_open_question();
        assert!(matches!(proof.answered(Some(good([1; 16])), own(140, 10)), Outcome::Proven));
        for retry in 1..=QUICK_RETRIES + 1 {
            proof.ask([2; 16], raw(100));
            assert!(matches!(proof.answered(Some(good([2; 16])), own(5_101, 12)), Outcome::Slow));
            assert_eq!(proof.pause() == Duration::ZERO, retry <= QUICK_RETRIES);
        }
        assert_eq!(proof.holds_for(mono(13)), Some(Span::from_seconds(2)));
        assert!(proof.expire(mono(15)));
    }

    #[test]
    fn answer_without_question_or_twice_is_foreign() {
        let mut proof = proof_with_open_question();
        assert!(matches!(proof.answered(Some(good([1; 16])), own(140, 10)), Outcome::Proven));
        assert!(matches!(proof.answered(Some(good([1; 16])), own(140, 10)), Outcome::Foreign), "a replay");
        let mut proof = proof_with_open_question();
        assert!(matches!(proof.answered(None, own(140, 10)), Outcome::Foreign));
    }

    proptest! {
        #[test]
        fn only_sessions_cloud_with_same_clock_proves_it(
            nonce in prop_oneof![Just([1; 16]), any::<Nonce>()],
            session in prop_oneof![Just(SESSION), any::<[u8; 16]>()],
            time_namespace in prop_oneof![Just(NAMESPACE), any::<u64>()],
            kernel in any::<(bool, bool)>(),
            offset_us in prop_oneof![Just(0i64), -100_000i64..100_000],
            (there_us, back_us) in (0i64..4_000, 0i64..4_000),
        ) {
            let mut proof = proof_with_open_question();
            let answer = Answer {
                nonce, session, time_namespace,
                shows_kernel_time: kernel.0,
                raw: raw(100 + there_us + offset_us),
            };
            let own_clock = OwnClock { shows_kernel_time: kernel.1, ..own(100 + there_us + back_us, 10) };
            let outcome = proof.answered(Some(answer), own_clock);
            let is_proven = matches!(outcome, Outcome::Proven);
            prop_assert_eq!(is_proven, proof.holds_for(mono(10)).is_some());
            let is_cloud = nonce == [1; 16] && session == SESSION;
            prop_assert_eq!(is_cloud, !matches!(outcome, Outcome::Foreign));
            if is_proven {
                prop_assert!(is_cloud && time_namespace == NAMESPACE && kernel == (true, true));
                prop_assert!(offset_us.abs() <= MAX_ROUND_TRIP.nanos() / 1_000);
            } else if is_cloud && time_namespace == NAMESPACE && kernel == (true, true) && offset_us == 0 {
                prop_assert!(there_us + back_us > 5_000, "the truth was refused: {outcome:?}");
            }
        }

        #[test]
        fn messages_read_back_as_written(
            nonce: Nonce, session: [u8; 16], time_namespace: u64, shows_kernel_time: bool, nanos: i64,
        ) {
            let question = Question { nonce };
            prop_assert_eq!(Question::from_bytes(&question.to_bytes()), Some(question));
            let raw = RawTime::from_nanos(nanos);
            let answer = Answer { nonce, session, time_namespace, shows_kernel_time, raw };
            prop_assert_eq!(Answer::from_bytes(&answer.to_bytes()), Some(answer));
        }

        #[test]
        fn other_bytes_are_refused(bytes: [u8; 32], more: [u8; 25]) {
            let mut answer = [0; Answer::BYTES];
            answer[..32].copy_from_slice(&bytes);
            answer[32..].copy_from_slice(&more);
            prop_assert_eq!(Answer::from_bytes(&answer), None);
            let mut question = [0; Question::BYTES];
            question.copy_from_slice(&bytes[..Question::BYTES]);
            prop_assert_eq!(Question::from_bytes(&question), None);
        }
    }
}
