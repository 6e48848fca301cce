//! Timer for the starts of iterations, more precise than a millisecond.

use std::io;
use std::os::fd::OwnedFd;

use peernet_clock::{MonoTime, SharedClock};
use rustix::time::{
    Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, timerfd_create, timerfd_settime,
};
use tokio::io::unix::AsyncFd;

/// A kernel timer (`timerfd`) on the monotonic clock.
///
/// Timers of tokio are rounded up to whole milliseconds. Latency counts from the intended start, so every iteration
/// would have up to a millisecond of additional latency.
#[derive(Debug)]
pub(crate) struct StartTimer {
    timer: AsyncFd<OwnedFd>,
    clock: SharedClock,
    /// Time to which the kernel's timer is set.
    armed_for: Option<MonoTime>,
}

impl StartTimer {
    /// Creates a timer that is not set.
    ///
    /// # Errors
    /// When the kernel refuses a timer because too many files are open.
    pub(crate) fn new(clock: SharedClock) -> io::Result<Self> {
        let flags = TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC;
        let timer = timerfd_create(TimerfdClockId::Monotonic, flags)?;
        #[expect(
            deprecated,
            reason = "its successor `AsyncFd::register` is unsafe, because the descriptor of some types can change or be closed; an OwnedFd \
                      keeps its descriptor open"
        )]
        let timer = AsyncFd::new(timer)?;
        Ok(Self { timer, clock, armed_for: None })
    }

    /// Waits until `at`; returns at once if `at` has passed. If the wait is cancelled and repeated for the same time,
    /// the timer is not set again.
    ///
    /// # Errors
    /// When the kernel refuses to set the timer.
    pub(crate) async fn wait_until(&mut self, at: MonoTime) -> io::Result<()> {
        // Only the difference is given to the kernel, because `at` may be a time of a clock with injected faults.
        let remaining = at - self.clock.mono();
        // A time of 0 would disarm the kernel's timer.
        if remaining.nanos() <= 0 {
            return Ok(());
        }
        if self.armed_for != Some(at) {
            let remaining = Timespec {
                tv_sec: remaining.nanos() / 1_000_000_000,
                tv_nsec: remaining.nanos() % 1_000_000_000,
            };
            let expiry = Itimerspec { it_interval: Timespec { tv_sec: 0, tv_nsec: 0 }, it_value: remaining };
            timerfd_settime(self.timer.get_ref(), TimerfdTimerFlags::empty(), &expiry)?;
            self.armed_for = Some(at);
        }
        loop {
            let mut ready = self.timer.readable().await?;
            // The kernel returns the number of expirations in eight bytes. The number is not used.
            let mut expirations = [0; 8];
            match ready
                .try_io(|timer| rustix::io::read(timer.get_ref(), &mut expirations).map_err(Into::into))
            {
                Ok(result) => {
                    self.armed_for = None;
                    return result.map(|_| ());
                }
                Err(_would_block) => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, Span, SystemClock};

    use super::*;

    #[tokio::test]
    async fn timer_never_fires_early_and_can_be_set_again() {
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let mut start_timer = StartTimer::new(Arc::clone(&clock)).expect("a timer");
        for millis in [3, 1, 0, -5, 2] {
            let at = clock.mono() + Span::from_millis(millis);
            start_timer.wait_until(at).await.expect("the timer can be set");
            assert!(clock.mono() >= at);
        }
    }

    #[tokio::test]
    async fn cancelled_wait_does_not_disturb_next_one() {
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let mut start_timer = StartTimer::new(Arc::clone(&clock)).expect("a timer");
        let far = clock.mono() + Span::from_seconds(3600);
        tokio::select! {
            biased;
            _ = start_timer.wait_until(far) => unreachable!("an hour has not passed"),
            () = std::future::ready(()) => {}
        }
        let near = clock.mono() + Span::from_millis(2);
        start_timer.wait_until(near).await.expect("the timer can be set");
        assert!(clock.mono() >= near);
    }
}
