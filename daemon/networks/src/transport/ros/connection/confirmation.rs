//! Confirmation that payloads arrive.

/// State of the confirmation, which is sent once. A ROS 2 publisher cannot know whether its payload topic is received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PayloadConfirmation {
    /// The sender knows which nodes receive its topics.
    NotNeeded,
    /// No payload has arrived yet.
    Pending,
    Due,
    Sent,
}

impl PayloadConfirmation {
    pub(super) fn new(confirms_payloads: bool) -> Self {
        if confirms_payloads { Self::Pending } else { Self::NotNeeded }
    }

    /// Notes that a payload arrived.
    pub(super) fn note_payload(&mut self) {
        if *self == Self::Pending {
            *self = Self::Due;
        }
    }

    /// Returns whether the confirmation is due. The confirmation then counts as sent.
    pub(super) fn take_if_due(&mut self) -> bool {
        let is_due = *self == Self::Due;
        if is_due {
            *self = Self::Sent;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_payload_is_confirmed_once_if_that_is_needed() {
        for (is_needed, expected) in [(true, [false, true, false]), (false, [false; 3])] {
            let mut confirmation = PayloadConfirmation::new(is_needed);
            let before_payload = confirmation.take_if_due();
            confirmation.note_payload();
            let after_first = confirmation.take_if_due();
            confirmation.note_payload();
            assert_eq!([before_payload, after_first, confirmation.take_if_due()], expected);
        }
    }
}
