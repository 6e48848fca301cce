//! Logs that events are being dropped: at the beginning, once a minute, and at the end.

use peernet_clock::{MonoTime, Span};

const SAY_EVERY: Span = Span::from_seconds(60);
/// Time without a further loss after which a period of losses is over.
const OVER_AFTER: Span = Span::from_seconds(5);

/// Watches the number of dropped events.
#[derive(Debug, Default)]
pub(super) struct Dropping {
    seen: Option<u64>,
    spell: Option<Spell>,
}

/// A period in which events are dropped.
#[derive(Clone, Copy, Debug)]
struct Spell {
    before: u64,
    last: MonoTime,
    said: MonoTime,
}

/// Report for the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Said {
    /// Events are being dropped; the number is that of this period so far.
    Dropping(u64),
    /// The period is over; the number is its total.
    Over(u64),
}

impl Dropping {
    /// Updates the total number of dropped events at `now`, and returns a report if one is due.
    pub(super) fn look(&mut self, dropped: u64, now: MonoTime) -> Option<Said> {
        let seen = self.seen.replace(dropped).unwrap_or(dropped);
        match &mut self.spell {
            None if dropped > seen => {
                self.spell = Some(Spell { before: seen, last: now, said: now });
                Some(Said::Dropping(dropped - seen))
            }
            None => None,
            Some(spell) => {
                if dropped > seen {
                    spell.last = now;
                }
                let count = dropped - spell.before;
                if now - spell.last >= OVER_AFTER {
                    self.spell = None;
                    return Some(Said::Over(count));
                }
                (now - spell.said >= SAY_EVERY).then(|| {
                    spell.said = now;
                    Said::Dropping(count)
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spell_is_told_at_its_beginning_once_a_minute_and_at_its_end() {
        let at = |seconds: i64| MonoTime::from_nanos(0) + Span::from_seconds(seconds);
        let mut dropping = Dropping::default();
        // Events that were dropped before the start are not reported.
        assert_eq!(dropping.look(7, at(0)), None);
        assert_eq!(dropping.look(9, at(1)), Some(Said::Dropping(2)));
        let told: Vec<_> = (2..130).filter_map(|s| dropping.look(9 + s as u64, at(s))).collect();
        assert_eq!(told, [Said::Dropping(63), Said::Dropping(123)]);
        assert_eq!(dropping.look(138, at(133)), None);
        assert_eq!(dropping.look(138, at(134)), Some(Said::Over(131)));
        assert_eq!(dropping.look(138, at(500)), None);
    }
}
