//! Messages that `rustdds` carries as bytes.

use std::convert::Infallible;

use bytes::{BufMut, Bytes, BytesMut};
use rustdds::RepresentationIdentifier;
use rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};

/// A message with its encapsulation header.
pub(super) struct RawMessage(pub(super) Bytes);

/// Adapter for messages that are serialized already.
pub(super) struct RawAdapter;

/// Decoder that copies the bytes out of the cache of `rustdds`.
#[derive(Clone)]
pub(super) struct RawDecoder;

impl RawMessage {
    /// Length of the encapsulation header: two bytes for the representation, two for its options.
    pub(super) const HEADER_BYTES: usize = 4;

    /// Wraps a payload; `None` if it does not have the header of little-endian CDR.
    pub(super) fn from_payload(payload: Bytes) -> Option<Self> {
        // On the wire, rustdds always writes the header of `output_encoding`, so the payload must have this header.
        payload.starts_with(&[0, 1, 0, 0]).then_some(Self(payload))
    }
}

impl SerializerAdapter<RawMessage> for RawAdapter {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    // rustdds adds the header again.
    fn to_bytes(message: &RawMessage) -> Result<Bytes, Infallible> {
        Ok(message.0.slice(RawMessage::HEADER_BYTES..))
    }
}

impl DeserializerAdapter<RawMessage> for RawAdapter {
    type Error = Infallible;
    type Decoded = RawMessage;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        const { &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE] }
    }

    fn transform_decoded(decoded: RawMessage) -> RawMessage {
        decoded
    }
}

impl DefaultDecoder<RawMessage> for RawAdapter {
    type Decoder = RawDecoder;
    const DECODER: RawDecoder = RawDecoder;
}

impl Decode<'_, RawMessage> for RawDecoder {
    type Error = Infallible;

    // A received message is copied only here. The copy is needed because rustdds lends a slice of its cache.
    fn decode_bytes(
        self,
        bytes: &[u8],
        encoding: RepresentationIdentifier,
    ) -> Result<RawMessage, Infallible> {
        let little_endian = u8::from(encoding == RepresentationIdentifier::CDR_LE);
        let mut payload = BytesMut::with_capacity(RawMessage::HEADER_BYTES + bytes.len());
        payload.put_slice(&[0, little_endian, 0, 0]);
        payload.put_slice(bytes);
        Ok(RawMessage(payload.freeze()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn payload_keeps_its_header() {
        let payload = Bytes::from_static(&[0, 1, 0, 0, 7, 8]);
        let message = RawMessage::from_payload(payload.clone()).expect("little-endian CDR");
        let Ok(sent) = RawAdapter::to_bytes(&message);
        assert_eq!(sent[..], [7, 8]);
        let Ok(received) = RawDecoder.decode_bytes(&sent, RepresentationIdentifier::CDR_LE);
        assert_eq!(received.0, payload);
        for other in [&[][..], &[0, 1, 0], &[0, 0, 0, 0, 1], &[0, 3, 0, 0]] {
            assert!(RawMessage::from_payload(Bytes::copy_from_slice(other)).is_none(), "{other:?}");
        }
    }
}
