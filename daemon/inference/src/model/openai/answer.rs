//! An answer that arrives in chunks: its text, and the times at which its chunks arrived. No I/O.
//!
//! A chunk is an event of the stream with text of the answer or of the reasoning. Events that have only a role or the
//! number of tokens are not chunks.

use peernet_clock::{MonoTime, Span};

use super::event_data::{Choice, EventData, Usage, error_text_of_body};
use super::event_stream::{Event, EventStream};
use super::stream_error::StreamError;

/// Maximum length of the text of an answer, bytes.
const MAX_TEXT_BYTES: usize = 1 << 20;
/// Maximum number of bytes of a stream: an event with one token has a few hundred bytes.
const MAX_STREAM_BYTES: usize = 256 << 20;
/// Maximum number of chunks.
// The arrival time of each chunk takes 8 bytes of memory.
const MAX_CHUNKS: usize = 1 << 20;
/// Data of the event that ends the stream.
const DONE: &str = "[DONE]";

/// Answer of a language model as far as it has arrived.
#[derive(Debug)]
pub(super) struct StreamedAnswer {
    /// Time at which the request started.
    pub(super) started_at: MonoTime,
    /// Time at which the connection was open.
    pub(super) connected_at: Option<MonoTime>,
    /// Arrival of the first chunk with text of the answer.
    pub(super) first_content_at: Option<MonoTime>,
    /// Arrival of the first chunk with text of the reasoning.
    pub(super) first_reasoning_at: Option<MonoTime>,
    /// Arrivals of all chunks, in order.
    pub(super) chunk_times: Vec<MonoTime>,
    /// Text of the answer, without the reasoning.
    pub(super) text: String,
    /// Numbers of tokens, as the server counted them.
    pub(super) usage: Option<Usage>,
    /// First value in the stream that the server reports as a number of tokens and that cannot be one.
    pub(super) usage_defect: Option<String>,
    /// Reason why the answer ended, such as `stop` or `length`.
    pub(super) finish_reason: Option<String>,
    /// Index of a choice that has text although its index is not 0. Only the text of the choice with index 0 is the
    /// answer.
    other_choice: Option<String>,
    is_done: bool,
    events: EventStream,
    /// Number of events with data so far, whether they are chunks or not; does not count the event that ends the
    /// stream.
    event_count: u64,
    byte_count: usize,
}

impl StreamedAnswer {
    /// Creates an answer to a request that starts at the given time.
    pub(super) fn new(started_at: MonoTime) -> Self {
        Self {
            started_at,
            connected_at: None,
            first_content_at: None,
            first_reasoning_at: None,
            chunk_times: Vec::new(),
            text: String::new(),
            usage: None,
            usage_defect: None,
            finish_reason: None,
            other_choice: None,
            is_done: false,
            events: EventStream::default(),
            event_count: 0,
            byte_count: 0,
        }
    }

    /// Takes the next bytes of the stream, which arrived at the time `at`. Passes the new text of the answer to
    /// `receive_text`.
    ///
    /// # Errors
    /// If the stream is not an answer. The text and the times that were received before remain.
    pub(super) fn receive(
        &mut self,
        at: MonoTime,
        bytes: &[u8],
        mut receive_text: impl FnMut(&str),
    ) -> Result<(), StreamError> {
        self.byte_count += bytes.len();
        if self.byte_count > MAX_STREAM_BYTES {
            return Err(StreamError::TooLong("256 MiB"));
        }
        // The parser is taken out of `self`, because the closure borrows `self`.
        let mut events = std::mem::take(&mut self.events);
        let result = events.receive(bytes, |event| self.receive_event(at, &event, &mut receive_text));
        self.events = events;
        result
    }

    fn receive_event(
        &mut self,
        at: MonoTime,
        event: &Event<'_>,
        receive_text: &mut impl FnMut(&str),
    ) -> Result<(), StreamError> {
        let data = event.data;
        // Servers may send empty events to keep the connection open.
        if self.is_done || data.trim().is_empty() {
            return Ok(());
        }
        if data.trim() == DONE {
            self.is_done = true;
            return Ok(());
        }
        self.event_count += 1;
        if event.is_error {
            return Err(self.server_error(error_text_of_body(data.as_bytes())));
        }
        let event: EventData<'_> = serde_json::from_str(data)
            .map_err(|error| StreamError::Event { number: self.event_count, reason: error.to_string() })?;
        // Some servers do not mark an event that reports an error. Then only the data shows the error.
        if event.is_error() {
            return Err(self.server_error(error_text_of_body(data.as_bytes())));
        }
        if let Some(usage) = &event.usage {
            let (usage, defect) = Usage::read(usage);
            self.usage = Some(usage);
            self.usage_defect = self.usage_defect.take().or(defect);
        }
        let (index_0_choices, other_choices): (Vec<_>, Vec<_>) =
            event.choices.into_iter().flatten().partition(Choice::is_first);
        if self.other_choice.is_none() {
            self.other_choice = other_choices.iter().find(|choice| choice.has_text()).map(Choice::index_text);
        }
        match index_0_choices.into_iter().next() {
            Some(choice) => self.receive_choice(at, choice, receive_text),
            None => Ok(()),
        }
    }

    const fn server_error(&self, text: String) -> StreamError {
        StreamError::Server { chunk_count: self.chunk_count(), text }
    }

    fn receive_choice(
        &mut self,
        at: MonoTime,
        choice: Choice,
        receive_text: &mut impl FnMut(&str),
    ) -> Result<(), StreamError> {
        if let Some(text) = choice.error_text() {
            return Err(self.server_error(text));
        }
        // A whole answer in place of a `delta` is an error only before the first chunk: a server may stream an answer
        // and repeat the whole answer in the last event.
        if let Some(field) = choice.field_of_whole_text().filter(|_| self.chunk_times.is_empty()) {
            return Err(StreamError::NoDelta { number: self.event_count, field });
        }
        let delta = choice.delta.unwrap_or_default();
        let has_reasoning = delta.has_reasoning();
        // The first event often has a role and no text, so it is not a chunk.
        let content = delta.content.filter(|content| !content.is_empty());
        if has_reasoning {
            self.first_reasoning_at.get_or_insert(at);
        }
        if let Some(content) = &content {
            if self.text.len() + content.len() > MAX_TEXT_BYTES {
                return Err(StreamError::TooLong("1 MiB"));
            }
            self.first_content_at.get_or_insert(at);
            self.text.push_str(content);
            receive_text(content);
        }
        if has_reasoning || content.is_some() {
            if self.chunk_times.len() >= MAX_CHUNKS {
                return Err(StreamError::TooLong("1,048,576 chunks"));
            }
            self.chunk_times.push(at);
        }
        self.finish_reason = choice.finish_reason.or(self.finish_reason.take());
        Ok(())
    }

    /// Returns whether the event that ends the stream has arrived.
    pub(super) const fn is_done(&self) -> bool {
        self.is_done
    }

    /// Checks that the answer is complete, when the stream or the connection has ended. If the server has sent a finish
    /// reason, the event that ends the stream may be missing, and the answer may have no text; for example, an answer
    /// that only calls a tool.
    ///
    /// # Errors
    /// If the answer is incomplete.
    pub(super) fn check_complete(&self) -> Result<(), StreamError> {
        if self.finish_reason.is_some() || (self.is_done && self.chunk_count() > 0) {
            Ok(())
        } else if let Some(index) = self.other_choice.as_ref().filter(|_| self.chunk_times.is_empty()) {
            Err(StreamError::OtherChoice(index.clone()))
        } else if self.is_done {
            Err(StreamError::WithoutText)
        } else if self.byte_count > 0 && !self.events.has_field() {
            Err(StreamError::NoEvents(self.byte_count))
        } else {
            Err(StreamError::EndedEarly(self.chunk_count()))
        }
    }

    /// Returns the number of chunks. A chunk may consist of several tokens.
    pub(super) const fn chunk_count(&self) -> u64 {
        self.chunk_times.len() as u64
    }

    /// Returns the arrival of the last chunk.
    pub(super) fn last_chunk_at(&self) -> Option<MonoTime> {
        self.chunk_times.last().copied()
    }

    /// Returns the times between successive chunks.
    pub(super) fn chunk_intervals(&self) -> Vec<Span> {
        self.chunk_times.windows(2).map(|times| times[1] - times[0]).collect()
    }

    /// Returns the time between the first and the last chunk; `None` without chunks.
    pub(super) fn decode_time(&self) -> Option<Span> {
        Some(*self.chunk_times.last()? - *self.chunk_times.first()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::from_nanos(millis * 1_000_000)
    }

    fn content(text: &str) -> String {
        format!("data: {{\"choices\":[{{\"delta\":{{\"content\":{text:?}}}}}]}}\n\n")
    }

    fn receive(answer: &mut StreamedAnswer, millis: i64, stream: &str) -> Result<(), StreamError> {
        answer.receive(at(millis), stream.as_bytes(), |_| ())
    }

    #[test]
    fn events_without_text_are_no_chunks() {
        let mut answer = StreamedAnswer::new(at(0));
        let role = "data: {\"choices\":[{\"delta\":{\"role\":\"assistant\",\"content\":\"\"}}]}\n\n";
        receive(&mut answer, 10, role).expect("is an event");
        receive(&mut answer, 20, "data:\n\n: ping\n\ndata: {\"choices\":[]}\n\n").expect("is an event");
        assert_eq!((answer.first_content_at, answer.chunk_count()), (None, 0));
        let mut passed_text = String::new();
        let stream = [content("a"), content("b c")].concat();
        answer.receive(at(30), stream.as_bytes(), |text| passed_text.push_str(text)).expect("are chunks");
        assert_eq!((answer.first_content_at, answer.chunk_count()), (Some(at(30)), 2));
        assert_eq!((&*answer.text, &*passed_text), ("ab c", "ab c"));
        assert!(answer.check_complete().is_err());
        receive(&mut answer, 40, "data: [DONE]\n\ndata: not a chunk\n\n")
            .expect("events after the end are ignored");
        assert!(answer.is_done() && answer.check_complete().is_ok());
    }

    #[test]
    fn reasoning_precedes_first_content_token() {
        let mut answer = StreamedAnswer::new(at(0));
        for (millis, field) in [(5, "reasoning_content"), (9, "reasoning")] {
            let chunk = format!("data: {{\"choices\":[{{\"delta\":{{\"{field}\":\"hm\"}}}}]}}\n\n");
            receive(&mut answer, millis, &chunk).expect("is a chunk");
        }
        receive(&mut answer, 20, &content("a")).expect("is a chunk");
        assert_eq!((answer.first_reasoning_at, answer.first_content_at), (Some(at(5)), Some(at(20))));
        assert_eq!(answer.chunk_intervals(), [Span::from_millis(4), Span::from_millis(11)]);
        assert_eq!((answer.decode_time(), &*answer.text), (Some(Span::from_millis(15)), "a"));
    }

    #[test]
    fn broken_stream_is_refused_with_reason() {
        let mut answer = StreamedAnswer::new(at(0));
        receive(&mut answer, 1, &content("a")).expect("is a chunk");
        let error = receive(&mut answer, 2, "data: {\"error\":{\"message\":\"out of memory\"}}\n\n");
        let error = error.expect_err("is an error").to_string();
        assert_eq!(error, "its server ended the answer after 1 chunk: out of memory");
        let error =
            receive(&mut answer, 3, "data: {\"choices\":\n\n").expect_err("the event is cut off").to_string();
        assert!(error.starts_with("event 3 of its answer cannot be read: EOF"), "{error}");
        let error = answer.check_complete().expect_err("is not complete").to_string();
        assert_eq!(error, "its server closed the connection after 1 chunk without ending the answer");
        let long = content(&"x".repeat(600_000));
        receive(&mut answer, 4, &long).expect("is short enough");
        assert_eq!(receive(&mut answer, 5, &long), Err(StreamError::TooLong("1 MiB")));
        let endless = "x".repeat((1 << 20) + 1);
        let error = receive(&mut answer, 6, &endless).expect_err("has no end").to_string();
        assert_eq!(
            error,
            "its server sent an event longer than 1 MiB; check that url is the server's chat API"
        );
    }
}
