//! The next timer call of each connection of a port, in an order in which the earliest one is found without visiting
//! all connections.

use std::collections::{BTreeSet, HashMap};

use peernet_clock::MonoTime;

/// One time for each connection, in order.
#[derive(Debug, Default)]
pub(crate) struct Timers {
    by_time: BTreeSet<(MonoTime, u64)>,
    by_connection: HashMap<u64, MonoTime>,
}

impl Timers {
    /// Sets the time of a connection unless the connection already has an earlier time. A timer call that comes too
    /// early has no effect.
    pub(crate) fn schedule(&mut self, connection: u64, time: MonoTime) {
        match self.by_connection.get(&connection) {
            Some(earlier) if *earlier <= time => {}
            _ => {
                self.remove(connection);
                self.by_connection.insert(connection, time);
                self.by_time.insert((time, connection));
            }
        }
    }

    /// Removes a connection that has ended.
    pub(crate) fn remove(&mut self, connection: u64) {
        if let Some(time) = self.by_connection.remove(&connection) {
            self.by_time.remove(&(time, connection));
        }
    }

    /// Returns a connection that is due, and removes its time.
    pub(crate) fn take_due(&mut self, now: MonoTime) -> Option<u64> {
        let (_, connection) = *self.by_time.first().filter(|(time, _)| *time <= now)?;
        self.remove(connection);
        Some(connection)
    }

    /// Returns the earliest time of all connections.
    pub(crate) fn next_time(&self) -> Option<MonoTime> {
        self.by_time.first().map(|(time, _)| *time)
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;

    use super::*;

    #[test]
    fn connections_come_in_order_of_their_earliest_times() {
        let time_at = |millis| MonoTime::default() + Span::from_millis(millis);
        let mut timers = Timers::default();
        for (connection, millis) in [(1, 30), (2, 20), (3, 10), (1, 5), (2, 40), (4, 1)] {
            timers.schedule(connection, time_at(millis));
        }
        timers.remove(4);
        timers.remove(4);
        assert_eq!(timers.next_time(), Some(time_at(5)));
        let due: Vec<u64> = std::iter::from_fn(|| timers.take_due(time_at(10))).collect();
        assert_eq!(due, [1, 3]);
        assert_eq!((timers.take_due(time_at(19)), timers.next_time()), (None, Some(time_at(20))));
    }
}
