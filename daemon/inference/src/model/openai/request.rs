//! The request for a chat completion: a sample as JSON.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use peernet_sample::{MediaType, Part, Sample};
use serde_json::{Value, json};

use super::OpenaiConfig;

/// Creates the body of the request for a sample: the prompt, then the parts of the sample in their order.
///
/// # Errors
/// Returns a description of the sample's defect if a part is neither text nor a JPEG or PNG file.
pub(super) fn body(config: &OpenaiConfig, sample: &Sample) -> Result<Bytes, String> {
    let mut messages = Vec::new();
    if let Some(text) = &config.system_prompt {
        messages.push(json!({ "role": "system", "content": text }));
    }
    messages.push(json!({ "role": "user", "content": content(config, sample)? }));
    let mut body = config.parameters.clone();
    body.insert("model".to_owned(), config.model.clone().into());
    body.insert("messages".to_owned(), messages.into());
    body.insert("stream".to_owned(), true.into());
    // Without this option, servers do not report how many tokens a streamed answer has.
    body.insert("stream_options".to_owned(), json!({ "include_usage": true }));
    serde_json::to_vec(&body).map(Bytes::from).map_err(|error| error.to_string())
}

/// Returns the content of the message with the role `user`. Without a picture, the content is one text, which servers
/// that do not support pictures understand, too.
fn content(config: &OpenaiConfig, sample: &Sample) -> Result<Value, String> {
    let mut texts: Vec<&str> = config.prompt.as_deref().into_iter().collect();
    let mut items: Vec<Value> = texts.iter().map(|text| text_item(text)).collect();
    for part in &sample.parts {
        match &part.description.media {
            MediaType::Text => {
                let text = std::str::from_utf8(&part.bytes)
                    .map_err(|error| format!("its text is not UTF-8: {error}"))?;
                texts.push(text);
                items.push(text_item(text));
            }
            MediaType::Jpeg | MediaType::Png => items.push(picture_item(part)),
            media => {
                return Err(format!(
                    "a part is {}; a language model takes text, JPEG and PNG (the transform `encode` turns pixels into JPEG or PNG)",
                    media.iana()
                ));
            }
        }
    }
    if items.is_empty() {
        return Err("it has no part, and the model has no prompt".to_owned());
    }
    Ok(if items.len() == texts.len() { texts.join("\n").into() } else { items.into() })
}

fn text_item(text: &str) -> Value {
    json!({ "type": "text", "text": text })
}

fn picture_item(part: &Part) -> Value {
    let mut url = format!("data:{};base64,", part.description.media.iana());
    STANDARD.encode_string(&part.bytes, &mut url);
    json!({ "type": "image_url", "image_url": { "url": url } })
}

#[cfg(test)]
mod tests {
    use peernet_sample::Description;

    use super::*;
    use crate::model::openai::tests::config;

    fn part(media: MediaType, bytes: &'static [u8]) -> Part {
        Part { description: Description::unshaped(media), bytes: Bytes::from_static(bytes) }
    }

    fn sample(parts: Vec<Part>) -> Sample {
        Sample { parts, source: String::new(), label: None }
    }

    fn read(config: &OpenaiConfig, parts: Vec<Part>) -> Result<Value, String> {
        body(config, &sample(parts)).map(|body| serde_json::from_slice(&body).expect("is JSON"))
    }

    #[test]
    fn text_sample_becomes_one_message() {
        let mut config = config("http://gpu/v1");
        config.parameters =
            json!({ "max_tokens": 8, "temperature": 0.5 }).as_object().expect("a table").clone();
        config.system_prompt = Some("Be brief.".to_owned());
        config.prompt = Some("Translate:".to_owned());
        let body = read(&config, vec![part(MediaType::Text, "Grüße".as_bytes())]).expect("is text");
        let expected = json!({
            "model": "llava", "max_tokens": 8, "temperature": 0.5, "stream": true,
            "stream_options": { "include_usage": true },
            "messages": [
                { "role": "system", "content": "Be brief." },
                { "role": "user", "content": "Translate:\nGrüße" },
            ],
        });
        assert_eq!(body, expected);
    }

    #[test]
    fn pictures_become_data_urls_in_order() {
        let mut config = config("http://gpu/v1");
        config.prompt = Some("Compare.".to_owned());
        let parts = vec![
            part(MediaType::Jpeg, b"\xff\xd8"),
            part(MediaType::Text, b"before"),
            part(MediaType::Png, b"\x89PNG"),
        ];
        let body = read(&config, parts).expect("are pictures");
        let expected = json!([
            { "type": "text", "text": "Compare." },
            { "type": "image_url", "image_url": { "url": "data:image/jpeg;base64,/9g=" } },
            { "type": "text", "text": "before" },
            { "type": "image_url", "image_url": { "url": "data:image/png;base64,iVBORw==" } },
        ]);
        assert_eq!(body["messages"][0]["content"], expected);
    }

    #[test]
    fn unsupported_sample_is_refused_with_advice() {
        let config = config("http://gpu/v1");
        for (parts, reason) in [
            (vec![part(MediaType::Tensor, b"1")], "application/x-tensor; a language model takes text"),
            (vec![part(MediaType::Text, b"\xff")], "not UTF-8"),
            (vec![], "no part, and the model has no prompt"),
        ] {
            let error = read(&config, parts).expect_err(reason);
            assert!(error.contains(reason), "{error}");
        }
    }
}
