//! Conversion of answers with another status than 200 to errors.

use std::time::Duration;

use http_body_util::BodyExt;
use hyper::Response;
use hyper::body::Incoming;
use hyper::header::{CONTENT_ENCODING, HeaderName, LOCATION, RETRY_AFTER};
use tokio::time::timeout;

use super::error::RequestError;
use super::event_data::error_text_of_body;

/// Maximum number of bytes that are read of the body of an error.
const MAX_ERROR_BYTES: usize = 64 << 10;

/// Returns the compression of an answer, such as `gzip`; `None` if the answer is not compressed.
pub(super) fn content_encoding(response: &Response<Incoming>) -> Option<String> {
    let encoding = header_text(response, CONTENT_ENCODING)?;
    (!encoding.is_empty() && !encoding.eq_ignore_ascii_case("identity")).then_some(encoding)
}

/// Returns a header as text.
fn header_text(response: &Response<Incoming>, name: HeaderName) -> Option<String> {
    response.headers().get(name).map(|value| String::from_utf8_lossy(value.as_bytes()).trim().to_owned())
}

/// Converts an answer with an error status to an error. Reads as much of the body as arrives within `limit`.
pub(super) async fn status_error(mut response: Response<Incoming>, limit: Duration) -> RequestError {
    let status = response.status();
    let hint = if status.is_redirection() {
        header_text(&response, LOCATION)
    } else {
        header_text(&response, RETRY_AFTER).filter(|text| is_retry_after(text))
    };
    let mut body = Vec::new();
    let reading = async {
        while let Some(Ok(frame)) = response.body_mut().frame().await {
            body.extend(frame.data_ref().into_iter().flatten());
            if body.len() >= MAX_ERROR_BYTES {
                break;
            }
        }
    };
    // If the body does not end within the limit, the bytes that have arrived are used.
    let _ = timeout(limit, reading).await;
    let text = if content_encoding(&response).is_some() { String::new() } else { error_text_of_body(&body) };
    RequestError::Status { status, text, hint }
}

/// Returns whether a text is a number of seconds or a date, as RFC 9110 (sections 10.2.3 and 5.6.7) defines
/// `Retry-After`.
fn is_retry_after(text: &str) -> bool {
    // `parse` alone would accept a plus sign.
    let is_seconds = text.bytes().all(|byte| byte.is_ascii_digit()) && text.parse::<u32>().is_ok();
    // `A` and `a` stand for any letter, and `0` stands for any digit.
    let pattern = b"Aaa, 00 Aaa 0000 00:00:00 GMT";
    let is_date = text.len() == pattern.len()
        && text.bytes().zip(pattern).all(|(byte, symbol)| match symbol {
            b'0' => byte.is_ascii_digit(),
            b'A' | b'a' => byte.is_ascii_alphabetic(),
            symbol => byte == *symbol,
        });
    is_seconds || is_date
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn retry_after_is_seconds_or_date() {
        for text in ["0", "7", "4294967295", "Wed, 21 Oct 2099 07:28:00 GMT"] {
            assert!(is_retry_after(text), "{text}");
        }
        for text in ["", "-5", "1.5", "NaN", "99999999999999999999999999", "Wed, 21 Oct 2099", "in a minute"]
        {
            assert!(!is_retry_after(text), "{text}");
        }
    }
}
