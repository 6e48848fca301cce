//! Assigns output messages to input messages, in bounded memory. No I/O.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

#[cfg(test)]
mod tests;

/// Pairs the messages of two topics.
///
/// A message with a key is paired with the oldest message of the other topic that has the same key. The output message
/// may arrive before its input message, because the observed node may receive the input before the agent does. Messages
/// without a key are paired in the order of arrival.
#[derive(Debug)]
pub(super) struct Pairing<I, O> {
    /// Longest time that a message waits for its counterpart.
    timeout: Span,
    /// Maximum number of unpaired messages of each topic.
    capacity: usize,
    inputs: VecDeque<UnpairedMessage<I>>,
    outputs: VecDeque<UnpairedMessage<O>>,
}

/// A message that waits for its counterpart.
#[derive(Debug)]
struct UnpairedMessage<T> {
    key: Option<i64>,
    received_at: MonoTime,
    message: T,
}

/// Result of the search for the counterpart of a message.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Resolution<I, O> {
    /// The two messages are a pair.
    Paired { input: I, output: O },
    /// The input message has no output message.
    Unanswered { input: I, cause: UnansweredCause },
    /// The output message has no input message.
    Unmatched(O),
}

/// Reason why an input message has no output message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum UnansweredCause {
    /// No output message arrived in time.
    Expired,
    /// Too many newer input messages arrived while the input message waited.
    Displaced,
}

impl<I, O> Pairing<I, O> {
    /// Creates a pairing in which at most `capacity` messages of each topic wait, no longer than `timeout`.
    pub(super) fn new(timeout: Span, capacity: usize) -> Self {
        Self { timeout, capacity, inputs: VecDeque::new(), outputs: VecDeque::new() }
    }

    /// Adds an input message that was received at `at`. Returns the pair that the message completes. If more than
    /// `capacity` input messages wait, returns the oldest of them.
    pub(super) fn add_input(&mut self, key: Option<i64>, at: MonoTime, input: I) -> Option<Resolution<I, O>> {
        // Only output messages with a key wait. Without a key, a waiting output message would be paired with an input
        // message that was received later.
        if let Some(output) = remove(&mut self.outputs, key) {
            return Some(Resolution::Paired { input, output });
        }
        self.inputs.push_back(UnpairedMessage { key, received_at: at, message: input });
        let displaced = (self.inputs.len() > self.capacity).then(|| self.inputs.pop_front()).flatten()?;
        Some(Resolution::Unanswered { input: displaced.message, cause: UnansweredCause::Displaced })
    }

    /// Adds an output message that was received at `at`. Returns the pair that the message completes, or an output
    /// message that remains without a pair.
    pub(super) fn add_output(
        &mut self,
        key: Option<i64>,
        at: MonoTime,
        output: O,
    ) -> Option<Resolution<I, O>> {
        if key.is_none() {
            // An input message that was received later cannot be the cause of this output message.
            let oldest = self.inputs.pop_front_if(|oldest| oldest.received_at <= at);
            return Some(match oldest {
                Some(UnpairedMessage { message: input, .. }) => Resolution::Paired { input, output },
                None => Resolution::Unmatched(output),
            });
        }
        if let Some(input) = remove(&mut self.inputs, key) {
            return Some(Resolution::Paired { input, output });
        }
        self.outputs.push_back(UnpairedMessage { key, received_at: at, message: output });
        let displaced = (self.outputs.len() > self.capacity).then(|| self.outputs.pop_front()).flatten()?;
        Some(Resolution::Unmatched(displaced.message))
    }

    /// Removes a message whose timeout has passed by `now`. The caller calls this method until it returns `None`.
    pub(super) fn expire(&mut self, now: MonoTime) -> Option<Resolution<I, O>> {
        let timeout = self.timeout;
        if let Some(oldest) = self.inputs.pop_front_if(|oldest| now - oldest.received_at >= timeout) {
            return Some(Resolution::Unanswered { input: oldest.message, cause: UnansweredCause::Expired });
        }
        let oldest = self.outputs.pop_front_if(|oldest| now - oldest.received_at >= timeout)?;
        Some(Resolution::Unmatched(oldest.message))
    }

    /// Returns the time at which the next message expires; `None` if no message waits.
    pub(super) fn next_deadline(&self) -> Option<MonoTime> {
        let input = self.inputs.front().map(|oldest| oldest.received_at);
        let output = self.outputs.front().map(|oldest| oldest.received_at);
        input.into_iter().chain(output).min().map(|received_at| received_at + self.timeout)
    }

    /// Returns whether no input message waits.
    pub(super) fn has_no_unpaired_inputs(&self) -> bool {
        self.inputs.is_empty()
    }

    /// Removes and returns all input messages that wait, the oldest first.
    pub(super) fn take_unpaired_inputs(&mut self) -> impl Iterator<Item = I> + use<I, O> {
        std::mem::take(&mut self.inputs).into_iter().map(|unpaired| unpaired.message)
    }
}

/// Removes the oldest message with this key.
fn remove<T>(unpaired: &mut VecDeque<UnpairedMessage<T>>, key: Option<i64>) -> Option<T> {
    let wanted_key = key?;
    let index = unpaired.iter().position(|message| message.key == Some(wanted_key))?;
    unpaired.remove(index).map(|unpaired| unpaired.message)
}
