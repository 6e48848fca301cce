//! The signs of life of the other end, one after the other.

use crate::transport::datagram::packet::SignOfLife;

/// Signs of life in succession that contradict what was sent, at which the connection ends. It would not recover: the other
/// end takes messages that are still to be sent for settled.
const MAX_CONTRADICTIONS: u32 = 3;

/// Tells doubled signs of life from new ones, and ends that have lost touch from a single packet that was altered.
#[derive(Debug, Default)]
pub(super) struct SignHistory {
    last: SignOfLife,
    /// Signs in succession that contradict what was sent.
    contradictions: u32,
}

impl SignHistory {
    /// A sign of life arrived. Returns whether it is a new one: the network may have doubled the last.
    pub(super) fn hear(&mut self, sign: &SignOfLife) -> bool {
        std::mem::replace(&mut self.last, *sign) != *sign
    }

    /// The sign agrees with what was sent.
    pub(super) fn agree(&mut self) {
        self.contradictions = 0;
    }

    /// The sign contradicts what was sent. Returns whether too many in succession do.
    pub(super) fn contradict(&mut self) -> bool {
        self.contradictions += 1;
        self.contradictions >= MAX_CONTRADICTIONS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_contradictions_in_succession_are_too_many() {
        let mut signs = SignHistory::default();
        assert!(!signs.contradict() && !signs.contradict());
        signs.agree();
        assert!(!signs.contradict() && !signs.contradict() && signs.contradict());
    }

    #[test]
    fn doubled_sign_is_not_new() {
        let (mut signs, sign) = (SignHistory::default(), SignOfLife { time: 1, ..SignOfLife::default() });
        assert!(signs.hear(&sign) && !signs.hear(&sign));
        assert!(signs.hear(&SignOfLife { time: 2, ..sign }));
    }
}
