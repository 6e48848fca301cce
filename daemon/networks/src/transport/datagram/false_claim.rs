//! Claims of packets that cannot be true.

/// A claim of a packet that cannot be true, or that a single packet cannot prove: the packet may have been altered or
/// forged on the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum FalseClaim {
    /// The packet reports on messages that this end has not sent.
    #[error("a packet reports a message that was never sent")]
    UnsentMessage,
    /// The packet reports more fragments than the message has.
    #[error("a packet reports more fragments than the message has")]
    TooManyFragments,
    /// The packet has a message number far above all numbers that are known to have been sent.
    #[error("a packet has a message number that is too far ahead")]
    TooFarAhead,
    /// The packet reports totals above what was sent.
    #[error("a packet reports more datagrams than were sent")]
    TooManyDatagrams,
}
