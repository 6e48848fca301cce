//! Time limits of a request, and waiting within them.

use std::time::Duration;

use peernet_clock::{MonoTime, SharedClock, Span};
use tokio::time::timeout;

use super::answer::StreamedAnswer;
use super::error::RequestError;

/// Time limits of a request.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeLimits {
    /// From the start of the request to its first token, of the reasoning or of the answer.
    pub(super) first_token: Duration,
    /// From one chunk to the next, and from the last chunk to the end of the answer.
    pub(super) token: Duration,
    /// From the start of the request to the end of the answer.
    pub(super) total: Duration,
}

/// Deadlines of the steps of one answer: connection, response, chunks.
pub(super) struct AnswerDeadlines<'a> {
    limits: &'a TimeLimits,
    clock: &'a SharedClock,
    /// Time at which the wait for the next chunk started.
    pub(super) waiting_since: MonoTime,
}

impl<'a> AnswerDeadlines<'a> {
    /// Creates the deadlines of an answer to a request that started at the given time.
    pub(super) const fn new(limits: &'a TimeLimits, clock: &'a SharedClock, started_at: MonoTime) -> Self {
        Self { limits, clock, waiting_since: started_at }
    }

    /// Waits for a step of the answer until the earliest deadline.
    ///
    /// # Errors
    /// If the step does not end before this deadline.
    pub(super) async fn within<T>(
        &self,
        answer: &StreamedAnswer,
        step: impl Future<Output = T>,
    ) -> Result<T, RequestError> {
        let (remaining, timeout_error) = self.remaining(answer);
        // `timeout` does not check the limit if the result of a step is already there. Without this check, a server
        // whose chunks are always there when they are read would have no limit.
        if remaining.is_zero() {
            return Err(timeout_error);
        }
        timeout(remaining, step).await.map_err(|_| timeout_error)
    }

    /// Returns the time until the earliest deadline, and the error to return when this time has passed.
    pub(super) fn remaining(&self, answer: &StreamedAnswer) -> (Duration, RequestError) {
        let TimeLimits { first_token, token, total } = *self.limits;
        let chunk_count = answer.chunk_count();
        let (step_deadline, timeout_error) = if chunk_count == 0 {
            (answer.started_at + span(first_token), RequestError::FirstToken(first_token))
        } else {
            (self.waiting_since + span(token), RequestError::Token { limit: token, chunk_count })
        };
        let total_deadline = answer.started_at + span(total);
        let (deadline, timeout_error) = if total_deadline < step_deadline {
            (total_deadline, RequestError::Total { limit: total, chunk_count })
        } else {
            (step_deadline, timeout_error)
        };
        let remaining = u64::try_from((deadline - self.clock.mono()).nanos()).unwrap_or(0);
        (Duration::from_nanos(remaining), timeout_error)
    }
}

fn span(duration: Duration) -> Span {
    Span::from_nanos(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use std::future::ready;
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};

    use super::*;

    #[tokio::test]
    async fn answer_without_waits_ends_at_time_limit() {
        let millis = Duration::from_millis;
        let manual =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "clock")));
        let clock: SharedClock = Arc::<ManualClock>::clone(&manual);
        let limits = TimeLimits { first_token: millis(50), token: millis(20), total: millis(100) };
        let mut answer = StreamedAnswer::new(clock.mono());
        let mut deadlines = AnswerDeadlines::new(&limits, &clock, answer.started_at);
        assert_eq!(deadlines.within(&answer, ready(1)).await, Ok(1));
        manual.advance(Span::from_millis(50));
        assert_eq!(deadlines.within(&answer, ready(2)).await, Err(RequestError::FirstToken(millis(50))));
        let chunk = b"data: {\"choices\":[{\"delta\":{\"content\":\"a\"}}]}\n\n";
        answer.receive(clock.mono(), chunk, |_| ()).expect("is a chunk");
        // The requester took 30 ms to accept the chunk. This time does not count against the server's limit.
        manual.advance(Span::from_millis(30));
        deadlines.waiting_since = clock.mono();
        assert_eq!(deadlines.within(&answer, ready(3)).await, Ok(3));
        manual.advance(Span::from_millis(20));
        assert!(matches!(deadlines.within(&answer, ready(4)).await, Err(RequestError::Token { .. })));
        deadlines.waiting_since = clock.mono();
        let timeout_error = RequestError::Total { limit: millis(100), chunk_count: 1 };
        assert_eq!(deadlines.within(&answer, ready(5)).await, Err(timeout_error));
    }
}
