//! Parser of calls and responses. Sizes, depth and numbers are bounded, and document types are refused.

use quick_xml::Reader;
use quick_xml::events::{BytesRef, Event};
use thiserror::Error;

use super::{Call, Response, Value};

/// Largest nesting depth of values. ROS needs six, for the system state: answer, state, list of topics, topic, list of
/// the topic's nodes, name of a node.
const MAX_DEPTH: usize = 16;

/// Maximum number of values in a document. The largest answer is the system state of a large robot, a few thousand
/// names.
const MAX_VALUES: usize = 100_000;

/// Error: a text is not a call or response.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ParseError {
    /// The text is not XML.
    #[error("the XML is malformed: {reason}")]
    Malformed {
        /// Reason.
        reason: String,
    },
    /// The text has a document type, which can define entities.
    #[error("the XML has a document type, which XML-RPC does not allow")]
    DocumentType,
    /// The text refers to an entity that XML does not define itself.
    #[error("the XML refers to the unknown entity {name:?}")]
    UnknownEntity {
        /// Name of the entity.
        name: String,
    },
    /// The text contains an element or a text where XML-RPC expects something else.
    #[error("expected {expected} in the XML-RPC message, found {found}")]
    Unexpected {
        /// Expected element or text.
        expected: &'static str,
        /// Element or text that was found.
        found: String,
    },
    /// A value does not fit its type.
    #[error("{text:?} is not a value of the XML-RPC type {kind}")]
    Value {
        /// The type.
        kind: &'static str,
        /// The text.
        text: String,
    },
    /// Values are nested too deeply.
    #[error("the XML-RPC message has more than {MAX_DEPTH} nested values")]
    TooDeep,
    /// There are too many values.
    #[error("the XML-RPC message has more than {MAX_VALUES} values")]
    TooManyValues,
}

/// Parses a call.
///
/// # Errors
/// If the text is not a call: [`ParseError`].
pub fn parse_call(xml: &[u8]) -> Result<Call, ParseError> {
    let mut parser = Parser::new(utf8(xml)?);
    parser.open("methodCall")?;
    parser.open("methodName")?;
    let method = parser.text_until_close()?.trim().to_owned();
    let mut params = Vec::new();
    // The element may be missing if there are no parameters.
    if parser.open_or_close("params")? {
        while parser.open_or_close("param")? {
            params.push(parser.wrapped_value()?);
        }
        // The loop has read the end of `params`. The end of `methodCall` follows.
        parser.close()?;
    }
    parser.end()?;
    Ok(Call { method, params })
}

/// Parses a response.
///
/// # Errors
/// If the text is not a response: [`ParseError`].
pub fn parse_response(xml: &[u8]) -> Result<Response, ParseError> {
    let mut parser = Parser::new(utf8(xml)?);
    parser.open("methodResponse")?;
    let response = match parser.next_markup()? {
        Token::Open(name) if name == "params" => {
            parser.open("param")?;
            let value = parser.wrapped_value()?;
            parser.close()?;
            Response::Success(value)
        }
        Token::Open(name) if name == "fault" => parse_fault(parser.wrapped_value()?)?,
        token => return Err(token.unexpected_error("params or fault")),
    };
    parser.close()?;
    parser.end()?;
    Ok(response)
}

fn parse_fault(value: Value) -> Result<Response, ParseError> {
    let (mut code, mut text) = (None, None);
    if let Value::Struct(members) = value {
        for (name, member) in members {
            match (name.as_str(), member) {
                ("faultCode", Value::Int(number)) => code = Some(number),
                ("faultString", Value::Text(reason)) => text = Some(reason),
                _ => {}
            }
        }
    }
    match (code, text) {
        (Some(code), Some(text)) => Ok(Response::Fault { code, text }),
        _ => Err(ParseError::Unexpected {
            expected: "faultCode and faultString",
            found: "another value".to_owned(),
        }),
    }
}

/// A token of the XML.
#[derive(Debug)]
enum Token {
    Open(String),
    Close,
    Text(String),
    End,
}

impl Token {
    fn unexpected_error(&self, expected: &'static str) -> ParseError {
        let found = match self {
            Self::Open(name) => format!("<{name}>"),
            Self::Close => "the end of an element".to_owned(),
            Self::Text(text) => format!("the text {text:?}"),
            Self::End => "the end".to_owned(),
        };
        ParseError::Unexpected { expected, found }
    }
}

/// Parser of a document.
struct Parser<'a> {
    reader: Reader<&'a [u8]>,
    /// Number of values that are open.
    depth: usize,
    /// Number of values so far.
    value_count: usize,
}

impl<'a> Parser<'a> {
    fn new(xml: &'a str) -> Self {
        let mut reader = Reader::from_str(xml);
        reader.config_mut().expand_empty_elements = true;
        Self { reader, depth: 0, value_count: 0 }
    }

    /// Returns the next token. A text may consist of several tokens.
    fn next(&mut self) -> Result<Token, ParseError> {
        loop {
            let event = self.reader.read_event().map_err(malformed)?;
            return Ok(match event {
                Event::Start(start) => Token::Open(start.local_name().as_ref().to_owned()),
                Event::End(_) => Token::Close,
                Event::Text(text) => Token::Text(text.to_string()),
                Event::CData(text) => Token::Text(text.to_string()),
                Event::GeneralRef(reference) => Token::Text(resolve(&reference)?),
                Event::DocType(_) => return Err(ParseError::DocumentType),
                Event::Eof => Token::End,
                // Elements without content are reported as a start and an end.
                Event::Empty(_) | Event::Comment(_) | Event::Decl(_) | Event::PI(_) => continue,
            });
        }
    }

    /// Returns the next token that is not white space between elements.
    fn next_markup(&mut self) -> Result<Token, ParseError> {
        loop {
            match self.next()? {
                Token::Text(text) if text.trim().is_empty() => {}
                token => return Ok(token),
            }
        }
    }

    /// Reads the start of the expected element.
    fn open(&mut self, expected: &'static str) -> Result<(), ParseError> {
        if self.open_or_close(expected)? { Ok(()) } else { Err(Token::Close.unexpected_error(expected)) }
    }

    /// Returns `true` if the expected element begins, `false` if the element around it has ended.
    fn open_or_close(&mut self, expected: &'static str) -> Result<bool, ParseError> {
        match self.next_markup()? {
            Token::Open(name) if name == expected => Ok(true),
            Token::Close => Ok(false),
            token => Err(token.unexpected_error(expected)),
        }
    }

    /// Reads the end of an element.
    fn close(&mut self) -> Result<(), ParseError> {
        match self.next_markup()? {
            Token::Close => Ok(()),
            token => Err(token.unexpected_error("the end of an element")),
        }
    }

    /// Reads the end of the document. Ends of elements may precede it.
    fn end(&mut self) -> Result<(), ParseError> {
        loop {
            match self.next_markup()? {
                Token::Close => {}
                Token::End => return Ok(()),
                token => return Err(token.unexpected_error("the end")),
            }
        }
    }

    /// Reads the text of an element and the end of the element.
    fn text_until_close(&mut self) -> Result<String, ParseError> {
        let mut content = String::new();
        loop {
            match self.next()? {
                Token::Text(text) => content.push_str(&text),
                Token::Close => return Ok(content),
                token => return Err(token.unexpected_error("text")),
            }
        }
    }

    /// Reads a value and the end of the element around it.
    fn wrapped_value(&mut self) -> Result<Value, ParseError> {
        self.open("value")?;
        let value = self.value()?;
        self.close()?;
        Ok(value)
    }

    /// Reads a value whose element has begun.
    fn value(&mut self) -> Result<Value, ParseError> {
        self.value_count += 1;
        self.depth += 1;
        if self.value_count > MAX_VALUES {
            return Err(ParseError::TooManyValues);
        }
        if self.depth > MAX_DEPTH {
            return Err(ParseError::TooDeep);
        }
        // A value without a type is a string. If there is a type, only white space may surround the element of the
        // type.
        let mut text = String::new();
        let value = loop {
            match self.next()? {
                Token::Text(piece) => text.push_str(&piece),
                Token::Close => break Value::Text(text),
                Token::Open(kind) if text.trim().is_empty() => {
                    let value = self.typed_value(&kind)?;
                    self.close()?;
                    break value;
                }
                token => return Err(token.unexpected_error("the end of the value")),
            }
        };
        self.depth -= 1;
        Ok(value)
    }

    fn typed_value(&mut self, kind: &str) -> Result<Value, ParseError> {
        match kind {
            "int" | "i4" | "i8" => self.scalar("int", |text| text.parse().ok().map(Value::Int)),
            "boolean" => self.scalar("boolean", |text| match text {
                "0" => Some(Value::Bool(false)),
                "1" => Some(Value::Bool(true)),
                _ => None,
            }),
            "double" => self.scalar("double", |text| text.parse().ok().map(Value::Double)),
            // Dates and binary data are kept as texts: ROS has them only in the parameter server, which PEERNet does
            // not read.
            "string" | "dateTime.iso8601" | "base64" => self.text_until_close().map(Value::Text),
            "array" => self.array(),
            "struct" => self.structure(),
            other => Err(Token::Open(other.to_owned()).unexpected_error("a type of XML-RPC")),
        }
    }

    fn scalar(
        &mut self,
        kind: &'static str,
        convert: impl Fn(&str) -> Option<Value>,
    ) -> Result<Value, ParseError> {
        let text = self.text_until_close()?;
        convert(text.trim()).ok_or(ParseError::Value { kind, text })
    }

    fn array(&mut self) -> Result<Value, ParseError> {
        self.open("data")?;
        let mut elements = Vec::new();
        while self.open_or_close("value")? {
            elements.push(self.value()?);
        }
        // The loop has read the end of `data`. The end of `array` follows.
        self.close()?;
        Ok(Value::Array(elements))
    }

    fn structure(&mut self) -> Result<Value, ParseError> {
        let mut members = Vec::new();
        while self.open_or_close("member")? {
            self.open("name")?;
            let name = self.text_until_close()?;
            members.push((name, self.wrapped_value()?));
        }
        Ok(Value::Struct(members))
    }
}

#[expect(clippy::needless_pass_by_value, reason = "map_err passes the error by value")]
fn malformed(error: impl ToString) -> ParseError {
    ParseError::Malformed { reason: error.to_string() }
}

fn utf8(bytes: &[u8]) -> Result<&str, ParseError> {
    std::str::from_utf8(bytes).map_err(malformed)
}

/// Returns the character that a reference such as `&amp;` or `&#13;` denotes.
fn resolve(reference: &BytesRef<'_>) -> Result<String, ParseError> {
    if let Some(character) = reference.resolve_char_ref().map_err(malformed)? {
        return Ok(character.to_string());
    }
    Ok(match &**reference {
        "amp" => "&",
        "lt" => "<",
        "gt" => ">",
        "quot" => "\"",
        "apos" => "'",
        name => return Err(ParseError::UnknownEntity { name: name.to_owned() }),
    }
    .to_owned())
}
