//! What a packet claims that its peer cannot mean.

/// A claim of a packet that cannot be true, or not by its word alone: it was altered or forged on the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum FalseClaim {
    /// Of messages that this end has not sent.
    #[error("a packet tells of a message that was never sent")]
    Unsent,
    /// Of a message with other fragments than it has.
    #[error("a packet tells of more fragments than the message has")]
    Fragments,
    /// Of a message that the other end has sent, far above those that are known.
    #[error("a packet has a message number that is too far ahead")]
    TooFarAhead,
    /// Of totals above what was sent.
    #[error("a packet counts more datagrams than were sent")]
    Totals,
}
