//! Writes calls and responses as XML.

use std::fmt::Write;

use super::{Call, Response, Value};

/// Returns the XML of a call.
pub fn write_call(call: &Call) -> String {
    let mut xml = String::from("<?xml version=\"1.0\"?>\n<methodCall><methodName>");
    write_text(&mut xml, &call.method);
    xml.push_str("</methodName><params>");
    for param in &call.params {
        xml.push_str("<param>");
        write_value(&mut xml, param);
        xml.push_str("</param>");
    }
    xml.push_str("</params></methodCall>\n");
    xml
}

/// Returns the XML of a response.
pub fn write_response(response: &Response) -> String {
    let mut xml = String::from("<?xml version=\"1.0\"?>\n<methodResponse>");
    match response {
        Response::Success(value) => {
            xml.push_str("<params><param>");
            write_value(&mut xml, value);
            xml.push_str("</param></params>");
        }
        Response::Fault { code, text } => {
            xml.push_str("<fault>");
            let members = [("faultCode", Value::Int(*code)), ("faultString", text.as_str().into())];
            write_value(
                &mut xml,
                &Value::Struct(members.map(|(name, value)| (name.to_owned(), value)).into()),
            );
            xml.push_str("</fault>");
        }
    }
    xml.push_str("</methodResponse>\n");
    xml
}

fn write_value(xml: &mut String, value: &Value) {
    xml.push_str("<value>");
    match value {
        Value::Int(number) => {
            let number = (*number).clamp(i64::from(i32::MIN), i64::from(i32::MAX));
            // Writing to a String cannot fail, here and below.
            let _ = write!(xml, "<int>{number}</int>");
        }
        Value::Bool(is_true) => {
            let _ = write!(xml, "<boolean>{}</boolean>", u8::from(*is_true));
        }
        Value::Double(number) => {
            // `Debug` keeps the decimal point of a whole number, which `Display` omits.
            let _ = write!(xml, "<double>{number:?}</double>");
        }
        Value::Text(text) => {
            xml.push_str("<string>");
            write_text(xml, text);
            xml.push_str("</string>");
        }
        Value::Array(elements) => {
            xml.push_str("<array><data>");
            elements.iter().for_each(|element| write_value(xml, element));
            xml.push_str("</data></array>");
        }
        Value::Struct(members) => {
            xml.push_str("<struct>");
            for (name, member) in members {
                xml.push_str("<member><name>");
                write_text(xml, name);
                xml.push_str("</name>");
                write_value(xml, member);
                xml.push_str("</member>");
            }
            xml.push_str("</struct>");
        }
    }
    xml.push_str("</value>");
}

/// Escapes markup, and the carriage return, which readers would turn into a line feed. A character that XML cannot
/// contain becomes U+FFFD.
fn write_text(xml: &mut String, text: &str) {
    for character in text.chars() {
        match character {
            '&' => xml.push_str("&amp;"),
            '<' => xml.push_str("&lt;"),
            '>' => xml.push_str("&gt;"),
            '\r' => xml.push_str("&#13;"),
            '\t' | '\n' => xml.push(character),
            '\0'..='\x1f' | '\u{fffe}' | '\u{ffff}' => xml.push('\u{fffd}'),
            _ => xml.push(character),
        }
    }
}
