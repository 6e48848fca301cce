//! Values, calls and responses of XML-RPC.

/// A value of XML-RPC.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// `int`, `i4` or `i8`. Written as `int`; a number beyond 32 bits becomes the nearest `int`.
    Int(i64),
    /// `boolean`.
    Bool(bool),
    /// `double`.
    Double(f64),
    /// `string`; also `dateTime.iso8601` and `base64` as they were written. ROS uses dates and binary data only in
    /// parameters.
    Text(String),
    /// `array`.
    Array(Vec<Value>),
    /// `struct`, with its members in the order of the text.
    Struct(Vec<(String, Value)>),
}

impl Value {
    /// Returns the text of a `string`.
    pub fn as_text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// Returns the number of an `int`.
    pub fn as_int(&self) -> Option<i64> {
        match self {
            Self::Int(number) => Some(*number),
            _ => None,
        }
    }

    /// Returns the elements of an `array`.
    pub fn as_array(&self) -> Option<&[Value]> {
        match self {
            Self::Array(elements) => Some(elements),
            _ => None,
        }
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<i64> for Value {
    fn from(number: i64) -> Self {
        Self::Int(number)
    }
}

impl<const N: usize> From<[Value; N]> for Value {
    fn from(elements: [Value; N]) -> Self {
        Self::Array(elements.into())
    }
}

impl From<Vec<Value>> for Value {
    fn from(elements: Vec<Value>) -> Self {
        Self::Array(elements)
    }
}

/// A call of a method.
#[derive(Clone, Debug, PartialEq)]
pub struct Call {
    /// Name of the method.
    pub method: String,
    /// Parameters in order.
    pub params: Vec<Value>,
}

/// The answer to a call.
#[derive(Clone, Debug, PartialEq)]
pub enum Response {
    /// The result of the method.
    Success(Value),
    /// The call failed before or in the method.
    Fault {
        /// Number of the failure. Its meaning depends on the server.
        code: i64,
        /// Reason.
        text: String,
    },
}
