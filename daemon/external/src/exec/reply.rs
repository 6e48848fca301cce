//! Assembly of a program's reply from lines and bytes. No I/O.

mod names;

use bytes::Bytes;
use peernet_clock::Span;
use peernet_sample::{MediaType, Part};

use super::error::FramingError;
use super::text_line::{shorten, split_first_word, text};
use super::{MAX_LINES, MAX_PARTS, MAX_SAMPLE_BYTES, Role, VERSION, shape};
use names::check_name;
use peernet_sample::printable_lines;

/// Reply of a program to one request.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// Notes that preceded the result.
    pub notes: ReplyNotes,
    /// Result of the request.
    pub outcome: ReplyOutcome,
}

/// Result of a request.
#[derive(Clone, Debug, PartialEq)]
pub enum ReplyOutcome {
    /// A sample of a sensor or an answer of a model.
    Parts(Vec<Part>),
    /// The actuator has acted, or the program was reset.
    Done,
    /// The sensor has no more samples.
    End,
    /// The request failed; the program still runs.
    Error(String),
}

/// Notes that a program may write before its result.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReplyNotes {
    /// The program's own stages in order: name and duration.
    pub stages: Vec<(String, Span)>,
    /// Values: name, number, symbol of the unit.
    pub values: Vec<(String, f64, String)>,
    /// Sequence number of a sensor's sample; gaps in it count dropped samples.
    pub sequence: Option<u64>,
    /// Expected answer to a sensor's sample.
    pub label: Option<String>,
    /// Origin of a sensor's sample.
    pub source: Option<String>,
    /// Reward that an actuator reports for its action.
    pub reward: Option<f64>,
    /// Whether the episode is a success so far, as an actuator reports it.
    pub success: Option<bool>,
    /// `true` if an actuator reports the end of the episode.
    pub episode_ended: bool,
}

/// Step that the caller of a [`ReplyAssembler`] takes next.
#[derive(Clone, Debug, PartialEq)]
pub enum AssemblyStep {
    /// Read a line, up to `\n`.
    ReadLine,
    /// Read this number of bytes.
    ReadBytes(u64),
    /// Pass on this partial answer of a model, then read a line.
    DeliverPartialAnswer(Part),
    /// Nothing more: this is the complete reply.
    Complete(Reply),
}

/// State machine that assembles one reply. Its caller reads the lines and bytes that the state machine asks for.
#[derive(Debug)]
pub struct ReplyAssembler {
    role: Role,
    /// `true` if the request was a reset. The reply to a reset has no notes and no sample.
    is_reset: bool,
    notes: ReplyNotes,
    parts: Vec<Part>,
    line_count: usize,
    /// Number of bytes of all parts so far.
    byte_count: u64,
    /// Description of the part whose bytes are expected next, and its position.
    pending_part: Option<(peernet_sample::Description, Position)>,
}

/// Position of a part in a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Position {
    /// Before the last part of the result.
    Inner,
    /// The last part of the result, with which the reply ends.
    Last,
    /// A partial answer, which is passed on at once, before the whole answer.
    Partial,
}

impl ReplyAssembler {
    /// Creates the assembler for one reply of a program in the given role.
    pub fn new(role: Role) -> Self {
        Self {
            role,
            is_reset: false,
            notes: ReplyNotes::default(),
            parts: Vec::new(),
            line_count: 0,
            byte_count: 0,
            pending_part: None,
        }
    }

    /// Creates the assembler for the reply of a program in the given role to a reset.
    pub fn for_reset(role: Role) -> Self {
        Self { is_reset: true, ..Self::new(role) }
    }

    /// Processes a line, without its `\n`.
    ///
    /// # Errors
    /// If the line does not follow the framing.
    pub fn push_line(&mut self, line: &[u8]) -> Result<AssemblyStep, FramingError> {
        self.line_count += 1;
        if self.line_count > MAX_LINES {
            return Err(FramingError::TooManyLines);
        }
        let line = text(line)?;
        let (word, rest) = split_first_word(line);
        let form_error = |form| FramingError::Form { line: shorten(line), form };
        let notes = &mut self.notes;
        match (word, self.role) {
            ("", _) if line.trim().is_empty() => {}
            ("version", _) => {
                let version = rest.parse().map_err(|_| form_error("version NUMBER"))?;
                if version != VERSION {
                    return Err(FramingError::Version(version));
                }
            }
            ("error", _) => return Ok(self.finish(ReplyOutcome::Error(printable_lines(rest).into_owned()))),
            ("done", _) if self.is_reset => return Ok(self.finish(ReplyOutcome::Done)),
            _ if self.is_reset => return Err(self.unknown_word(line)),
            ("stage", role) => {
                let (name, span) = parse_stage(rest).ok_or_else(|| form_error(STAGE_FORM))?;
                let allows_model_stages = role == Role::Model;
                notes.stages.push((check_name(name, allows_model_stages)?, span));
            }
            ("value", _) => {
                let (name, number, unit) = parse_value(rest).ok_or_else(|| form_error(VALUE_FORM))?;
                let allows_model_stages = false;
                notes.values.push((check_name(name, allows_model_stages)?, number, unit.to_owned()));
            }
            ("sequence", Role::Sensor) => {
                notes.sequence = Some(rest.parse().map_err(|_| form_error("sequence NUMBER"))?);
            }
            ("label", Role::Sensor) => notes.label = Some(rest.to_owned()).filter(|label| !label.is_empty()),
            ("source", Role::Sensor) => notes.source = Some(rest.to_owned()),
            ("end", Role::Sensor) => return Ok(self.finish(ReplyOutcome::End)),
            ("reward", Role::Actuator) => {
                let reward = rest.parse().ok().filter(|reward: &f64| reward.is_finite());
                let reward = reward.ok_or_else(|| form_error(REWARD_FORM))?;
                if notes.reward.replace(reward).is_some() {
                    return Err(FramingError::Repeated("reward"));
                }
            }
            ("success", Role::Actuator) => {
                let success = match rest {
                    "0" => false,
                    "1" => true,
                    _ => return Err(form_error(SUCCESS_FORM)),
                };
                if notes.success.replace(success).is_some() {
                    return Err(FramingError::Repeated("success"));
                }
            }
            ("episode-ended", Role::Actuator) => notes.episode_ended = true,
            ("done", Role::Actuator) => return Ok(self.finish(ReplyOutcome::Done)),
            // A sensor sends its sample with the word `answer`, too.
            ("answer" | "part", Role::Sensor | Role::Model) | ("partial", Role::Model) => {
                let (position, form) = match word {
                    "answer" => (Position::Last, ANSWER_FORM),
                    "part" => (Position::Inner, PART_FORM),
                    _ => (Position::Partial, PARTIAL_FORM),
                };
                // The error `None` means that the line does not have the expected form.
                return self
                    .announce_part(rest, position)
                    .map_err(|error| error.unwrap_or_else(|| form_error(form)));
            }
            _ => return Err(self.unknown_word(line)),
        }
        Ok(AssemblyStep::ReadLine)
    }

    /// Processes the bytes that [`AssemblyStep::ReadBytes`] asked for.
    pub fn push_bytes(&mut self, bytes: Bytes) -> AssemblyStep {
        let Some((description, position)) = self.pending_part.take() else { return AssemblyStep::ReadLine };
        let part = Part { description, bytes };
        match position {
            Position::Partial => {
                // An answer may have any number of partial answers. None of them stays in memory, so they do not count
                // towards the limits of lines and bytes.
                self.line_count -= 1;
                self.byte_count -= part.bytes.len() as u64;
                return AssemblyStep::DeliverPartialAnswer(part);
            }
            Position::Inner => self.parts.push(part),
            Position::Last => {
                self.parts.push(part);
                let parts = std::mem::take(&mut self.parts);
                return self.finish(ReplyOutcome::Parts(parts));
            }
        }
        AssemblyStep::ReadLine
    }

    /// Parses `BYTES [MEDIA-TYPE [SHAPE]]` and asks for the bytes. The error `None` means that the line does not have
    /// this form.
    fn announce_part(
        &mut self,
        rest: &str,
        position: Position,
    ) -> Result<AssemblyStep, Option<FramingError>> {
        let mut words = rest.split_ascii_whitespace();
        let bytes: u64 = words.next().and_then(|word| word.parse().ok()).ok_or(None)?;
        let media = words.next().map_or(MediaType::Bytes, MediaType::from_iana);
        let (description, bytes_of_shape) =
            shape::read(media, words.next().unwrap_or(shape::NOTHING)).ok_or(None)?;
        if words.next().is_some() {
            return Err(None);
        }
        // The size is checked before the bytes arrive, because the reader allocates the announced length.
        self.byte_count = self.byte_count.saturating_add(bytes);
        if self.byte_count > MAX_SAMPLE_BYTES {
            return Err(Some(FramingError::TooLarge(self.byte_count)));
        }
        if let Some(expected) = bytes_of_shape.filter(|expected| *expected != bytes) {
            return Err(Some(FramingError::Shape { bytes, expected }));
        }
        if self.parts.len() == MAX_PARTS {
            return Err(Some(FramingError::TooManyParts));
        }
        self.pending_part = Some((description, position));
        Ok(AssemblyStep::ReadBytes(bytes))
    }

    fn finish(&mut self, outcome: ReplyOutcome) -> AssemblyStep {
        AssemblyStep::Complete(Reply { notes: std::mem::take(&mut self.notes), outcome })
    }

    fn unknown_word(&self, line: &str) -> FramingError {
        let words = match self.role {
            _ if self.is_reset => "done, error, version (in reply to reset)",
            Role::Sensor => "answer, part, end, error, stage, value, sequence, label, source, version",
            Role::Model => "answer, part, partial, error, stage, value, version",
            Role::Actuator => "done, error, stage, value, reward, success, episode-ended, version",
        };
        FramingError::Word { line: shorten(line), role: self.role.with_article(), words: words.to_owned() }
    }
}

// Forms of lines. Errors quote these forms.
const STAGE_FORM: &str = "stage NAME SECONDS";
const REWARD_FORM: &str = "reward NUMBER";
const SUCCESS_FORM: &str = "success 0, or success 1";
const VALUE_FORM: &str = "value NAME NUMBER [UNIT]";
const ANSWER_FORM: &str = "answer BYTES [MEDIA-TYPE [SHAPE]] (a shape such as 480x640x3:u8)";
const PART_FORM: &str = "part BYTES [MEDIA-TYPE [SHAPE]] (a shape such as 480x640x3:u8)";
const PARTIAL_FORM: &str = "partial BYTES [MEDIA-TYPE [SHAPE]] (a shape such as 480x640x3:u8)";

/// Parses `NAME SECONDS`.
fn parse_stage(rest: &str) -> Option<(&str, Span)> {
    let (name, seconds) = split_name(rest)?;
    let seconds: f64 = seconds.parse().ok()?;
    // One day is longer than any stage and far below the largest value of `Span`.
    (0.0..=86_400.0).contains(&seconds).then(|| (name, Span::from_seconds_f64(seconds)))
}

/// Parses `NAME NUMBER [UNIT]`.
// The limits of names and units are below the limit of the logger (`MAX_NAME_BYTES`), which truncates longer texts.
fn parse_value(rest: &str) -> Option<(&str, f64, &str)> {
    let (name, rest) = split_name(rest)?;
    let (number, unit) = split_first_word(rest);
    let number: f64 = number.parse().ok()?;
    (number.is_finite() && unit.len() <= 16).then_some((name, number, unit))
}

/// Splits off a name of lower-case letters, digits and hyphens.
fn split_name(rest: &str) -> Option<(&str, &str)> {
    let (name, rest) = split_first_word(rest);
    let is_valid = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
    (!name.is_empty() && name.len() <= 64 && name.bytes().all(is_valid)).then_some((name, rest))
}

#[cfg(test)]
mod tests;
