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
    /// From one chunk to the next, and from the last to the end of the answer.
    pub(super) token: Duration,
    /// From the start of the request to the end of the answer.
    pub(super) total: Duration,
}

/// Waits for the steps of one answer (connection, response, chunks), with time limits.
pub(super) struct Waits<'a> {
    limits: &'a TimeLimits,
    clock: &'a SharedClock,
    /// Time since which nothing but the next chunk is awaited.
    pub(super) waiting_since: MonoTime,
}

impl<'a> Waits<'a> {
    /// Creates the waits of an answer to a request that started at the given time.
    pub(super) const fn new(limits: &'a TimeLimits, clock: &'a SharedClock, started_at: MonoTime) -> Self {
        Self { limits, clock, waiting_since: started_at }
    }

    /// Waits for a step of the answer, within the limit that ends first.
    ///
    /// # Errors
    /// If the step takes too long.
    pub(super) async fn within<T>(
        &self,
        answer: &StreamedAnswer,
        step: impl Future<Output = T>,
    ) -> Result<T, RequestError> {
        let (remaining, late) = self.remaining(answer);
        // `timeout` returns the result of a step that is already done without checking the limit. A server whose chunks
        // always arrive early would have no limit.
        if remaining.is_zero() {
            return Err(late);
        }
        timeout(remaining, step).await.map_err(|_| late)
    }

    /// Returns the time until the limit that ends first, and the error to return when this time has passed.
    pub(super) fn remaining(&self, answer: &StreamedAnswer) -> (Duration, RequestError) {
        let TimeLimits { first_token, token, total } = *self.limits;
        let after = answer.chunk_count();
        let (next, late) = if after == 0 {
            (answer.started_at + span(first_token), RequestError::FirstToken(first_token))
        } else {
            (self.waiting_since + span(token), RequestError::Token { limit: token, after })
        };
        let end = answer.started_at + span(total);
        let (deadline, late) =
            if end < next { (end, RequestError::Total { limit: total, after }) } else { (next, late) };
        let remaining = u64::try_from((deadline - self.clock.mono()).nanos()).unwrap_or(0);
        (Duration::from_nanos(remaining), late)
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
    async fn parts_that_never_lack_end_at_limit() {
        let millis = Duration::from_millis;
        let manual =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "clock")));
        let clock: SharedClock = Arc::<ManualClock>::clone(&manual);
        let limits = TimeLimits { first_token: millis(50), token: millis(20), total: millis(100) };
        let mut answer = StreamedAnswer::new(clock.mono());
        let mut waits = Waits::new(&limits, &clock, answer.started_at);
        assert_eq!(waits.within(&answer, ready(1)).await, Ok(1));
        manual.advance(Span::from_millis(50));
        assert_eq!(waits.within(&answer, ready(2)).await, Err(RequestError::FirstToken(millis(50))));
        let chunk = b"data: {\"choices\":[{\"delta\":{\"content\":\"a\"}}]}\n\n";
        answer.receive(clock.mono(), chunk, |_| ()).expect("is a chunk");
        // The requester took 30 ms to accept the chunk, which are not the server's.
        manual.advance(Span::from_millis(30));
        waits.waiting_since = clock.mono();
        assert_eq!(waits.within(&answer, ready(3)).await, Ok(3));
        manual.advance(Span::from_millis(20));
        let late = RequestError::Total { limit: millis(100), after: 1 };
        assert!(matches!(waits.within(&answer, ready(4)).await, Err(RequestError::Token { .. })));
        waits.waiting_since = clock.mono();
        assert_eq!(waits.within(&answer, ready(5)).await, Err(late));
    }
}
