//! Parser of server-sent events (WHATWG HTML Living Standard, section 9.2). No I/O.

/// Maximum length of an event and of a line, bytes. One event may have the text of many tokens.
const MAX_EVENT_BYTES: usize = 1 << 20;

/// Byte order mark that may precede a stream.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Parser of one stream, which takes bytes in pieces of any length.
///
/// An event consists of its data and of a mark if it reports an error; the fields `id` and `retry` and comments are
/// ignored.
#[derive(Debug, Default)]
pub(super) struct EventStream {
    /// Bytes of the current line, whose end has not arrived.
    line: Vec<u8>,
    /// Lines of the current event's data, each with a line feed.
    data: Vec<u8>,
    /// Whether the name of the current event is `error`, or a field with the name `error` contains its data.
    is_error: bool,
    /// Whether the last byte was a carriage return. A line feed that follows belongs to the same line end.
    ends_with_return: bool,
    /// Whether the first line has ended.
    has_ended_line: bool,
    /// Whether any line so far was a comment or a field of the standard.
    has_field: bool,
}

/// Names of the fields of the standard; a comment is a field with an empty name.
const FIELD_NAMES: [&[u8]; 5] = [b"", b"data", b"event", b"id", b"retry"];

/// An event of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Event<'a> {
    pub(super) data: &'a str,
    /// Whether the server marks the data as an error.
    pub(super) is_error: bool,
}

/// Name of events that report an error. llama.cpp writes their data into a field of this name, which the standard
/// does not have.
const ERROR_NAME: &[u8] = b"error";

/// Error: an event is longer than 1 MiB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct EventTooLong;

impl EventStream {
    /// Takes the next bytes of the stream. Passes each event that these bytes complete to `receive_event`.
    ///
    /// # Errors
    /// If an event is too long, or `receive_event` fails. The bytes that are not parsed by then are lost.
    // UTF-8 is decoded when an event is complete, because a character may be divided between two pieces.
    pub(super) fn receive<E: From<EventTooLong>>(
        &mut self,
        mut bytes: &[u8],
        mut receive_event: impl FnMut(Event<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        if bytes.is_empty() {
            return Ok(());
        }
        if std::mem::take(&mut self.ends_with_return) && bytes.first() == Some(&b'\n') {
            bytes = &bytes[1..];
        }
        while let Some(end) = bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r')) {
            self.extend_line(&bytes[..end])?;
            let is_crlf = bytes[end..].starts_with(b"\r\n");
            self.ends_with_return = bytes[end..] == *b"\r";
            bytes = &bytes[end + 1 + usize::from(is_crlf)..];
            if let Some((data, is_error)) = self.end_line()? {
                receive_event(Event { data: &String::from_utf8_lossy(&data), is_error })?;
            }
        }
        Ok(self.extend_line(bytes)?)
    }

    /// Returns whether the bytes so far contain a comment or a field of the standard, as every event stream does.
    pub(super) fn has_field(&self) -> bool {
        // The end of the current line may be missing.
        self.has_field || is_field(&self.line)
    }

    fn extend_line(&mut self, bytes: &[u8]) -> Result<(), EventTooLong> {
        if self.line.len() + bytes.len() > MAX_EVENT_BYTES {
            return Err(EventTooLong);
        }
        self.line.extend_from_slice(bytes);
        Ok(())
    }

    /// Ends a line. An empty line ends an event. Returns the data of the ended event and whether it is an error; `None`
    /// if no event with data has ended.
    fn end_line(&mut self) -> Result<Option<(Vec<u8>, bool)>, EventTooLong> {
        let is_first = !std::mem::replace(&mut self.has_ended_line, true);
        let mut line = &self.line[..];
        if is_first {
            line = line.strip_prefix(BYTE_ORDER_MARK).unwrap_or(line);
        }
        if line.is_empty() {
            self.line.clear();
            let mut data = std::mem::take(&mut self.data);
            let is_error = std::mem::take(&mut self.is_error);
            // According to the standard, the last line feed is removed, and an event without data is ignored.
            return Ok(data.pop().map(|_| (data, is_error)));
        }
        self.has_field |= is_field(line);
        let (name, value) = match line.iter().position(|byte| *byte == b':') {
            Some(colon) => (&line[..colon], &line[colon + 1..]),
            None => (line, &line[line.len()..]),
        };
        // According to the standard, only one space after the colon is removed.
        let value = value.strip_prefix(b" ").unwrap_or(value);
        if name == b"event" {
            self.is_error = value == ERROR_NAME;
        }
        self.is_error |= name == ERROR_NAME;
        if name == b"data" || name == ERROR_NAME {
            if self.data.len() + value.len() > MAX_EVENT_BYTES {
                return Err(EventTooLong);
            }
            self.data.extend_from_slice(value);
            self.data.push(b'\n');
        }
        self.line.clear();
        Ok(None)
    }
}

/// Returns whether a line begins with the name of a field and a colon.
fn is_field(line: &[u8]) -> bool {
    line.iter().position(|byte| *byte == b':').is_some_and(|colon| FIELD_NAMES.contains(&&line[..colon]))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Returns the events of a stream that arrives in these pieces.
    fn events(pieces: &[&[u8]]) -> Result<Vec<String>, EventTooLong> {
        let mut stream = EventStream::default();
        let mut found = Vec::new();
        for piece in pieces {
            stream.receive(piece, |event| {
                found.push(format!("{}{}", if event.is_error { "error " } else { "" }, event.data));
                Ok::<(), EventTooLong>(())
            })?;
        }
        Ok(found)
    }

    #[test]
    fn events_have_data_fields_only() {
        let stream = b"\xef\xbb\xbfdata: first\n\n: a comment\nevent: x\nid: 3\ndata:second\ndata:  third\n\nretry: 9\n\n\
                       data\n\ndatas: no\n\ndata: unfinished\n";
        assert_eq!(events(&[stream]).expect("short"), ["first", "second\n third", ""]);
    }

    #[test]
    fn events_of_errors_are_marked() {
        let stream = b"event: error\ndata: a\n\ndata: b\n\nerror: c\n\nevent: error\nevent: x\ndata: d\n\nevent: error\n\ndata: e\n\n";
        assert_eq!(events(&[stream]).expect("short"), ["error a", "b", "error c", "d", "e"]);
    }

    #[test]
    fn all_line_ends_are_accepted() {
        for end in ["\n", "\r", "\r\n"] {
            let stream = format!("data: a{end}{end}data: b{end}data: c{end}{end}");
            assert_eq!(events(&[stream.as_bytes()]).expect("short"), ["a", "b\nc"], "{end:?}");
        }
    }

    #[test]
    fn endless_event_is_refused() {
        let piece = [b'x'; 4096];
        let endless_line = vec![&piece[..]; MAX_EVENT_BYTES / piece.len() + 1];
        assert_eq!(events(&endless_line), Err(EventTooLong));
        let line = [b"data: ", &piece[..], b"\n"].concat();
        assert_eq!(events(&vec![&line[..]; MAX_EVENT_BYTES / piece.len() + 1]), Err(EventTooLong));
        // Comments do not count towards the length of an event.
        assert_eq!(events(&vec![&b": comment\n"[..]; 200_000]), Ok(vec![]));
    }

    proptest! {
        #[test]
        fn pieces_do_not_change_events(
            lines in proptest::collection::vec("(data: ?)?[aé漢\u{1f600}:]{0,5}(\r\n|\r|\n)", 0..20),
            cuts in proptest::collection::vec(0..200_usize, 0..20),
        ) {
            let stream = lines.concat().into_bytes();
            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(stream.len())).collect();
            cuts.extend([0, stream.len()]);
            cuts.sort_unstable();
            let pieces: Vec<&[u8]> = cuts.windows(2).map(|cut| &stream[cut[0]..cut[1]]).collect();
            prop_assert_eq!(events(&pieces), events(&[&stream]));
        }

        #[test]
        fn arbitrary_bytes_do_not_panic(pieces in proptest::collection::vec(
            proptest::collection::vec(any::<u8>(), 0..40), 0..10)) {
            let pieces: Vec<&[u8]> = pieces.iter().map(Vec::as_slice).collect();
            prop_assert!(events(&pieces).is_ok());
        }
    }
}
