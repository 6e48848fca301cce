//! Tests of headers, handshakes and frames.

use bytes::{BufMut, Bytes};
use proptest::prelude::*;

use super::{
    ConnectionHeader, FrameBuffer, FrameError, HandshakeError, HeaderError, MAX_HEADER_BYTES, Publication,
    Subscription, TopicType,
};
use crate::messages::{CompressedImage, StringMessage};
use crate::ros1::memory::MessageLimits;
use crate::ros1::tests::TestLimit;

fn publication(kind: TopicType) -> Publication {
    Publication { node: "/pub".into(), topic: "/t".into(), kind, is_latching: true }
}

fn subscription(kind: TopicType) -> Subscription {
    Subscription { node: "/sub".into(), topic: "/t".into(), kind }
}

/// Returns a header after encoding and decoding it.
fn encode_and_decode(header: &ConnectionHeader) -> ConnectionHeader {
    ConnectionHeader::decode(&header.encode()[4..]).unwrap()
}

#[test]
fn equal_types_connect() {
    let publication = publication(TopicType::from_message::<CompressedImage>());
    for kind in [TopicType::from_message::<CompressedImage>(), TopicType::any()] {
        let subscription = subscription(kind);
        let (answer, subscriber) = publication.answer(&encode_and_decode(&subscription.request())).unwrap();
        assert_eq!(&*subscriber, "/sub");
        assert_eq!(answer.get("latching"), Some("1"));
        let (publisher, kind) = subscription.accept(&encode_and_decode(&answer)).unwrap();
        assert_eq!((&*publisher, &*kind.name), ("/pub", "sensor_msgs/CompressedImage"));
        assert!(kind.definition.contains("MSG: std_msgs/Header"));
    }
}

#[test]
fn type_mismatch_names_both_types() {
    let publication = publication(TopicType::from_message::<CompressedImage>());
    let subscription = subscription(TopicType::from_message::<StringMessage>());
    let error = publication.answer(&encode_and_decode(&subscription.request())).unwrap_err();
    assert_eq!(
        error.to_string(),
        "topic /t has two message types: sensor_msgs/CompressedImage (md5sum 8f7a12909da2c9d3332d540a0977563f) here, \
         std_msgs/String (md5sum 992ce8a1687cec8c8bd883ec73ca41d1) at node /sub; \
         both must use the same definition of the type"
    );
    let refusal =
        subscription.accept(&encode_and_decode(&ConnectionHeader::error(&error.to_string()))).unwrap_err();
    assert!(matches!(refusal, HandshakeError::Refused { reason, .. } if reason == error.to_string()));
}

#[test]
fn other_topic_is_refused() {
    let mut subscription = subscription(TopicType::any());
    subscription.topic = "/other".into();
    let error = publication(TopicType::any()).answer(&subscription.request()).unwrap_err();
    assert_eq!(error.to_string(), "topic /other is not published by node /pub");
}

#[test]
fn malformed_headers_are_refused() {
    assert_eq!(ConnectionHeader::decode(b"abc").unwrap_err(), HeaderError::TooShort);
    assert_eq!(ConnectionHeader::decode(b"\x05\0\0\0a=b").unwrap_err(), HeaderError::TooShort);
    assert_eq!(ConnectionHeader::decode(b"\xff\xff\xff\xffa=b").unwrap_err(), HeaderError::TooShort);
    assert_eq!(ConnectionHeader::decode(b"\x03\0\0\0abc").unwrap_err(), HeaderError::NoSeparator);
    assert_eq!(ConnectionHeader::decode(b"\x02\0\0\0=\xff").unwrap_err(), HeaderError::NotUtf8);
    assert_eq!(
        ConnectionHeader::decode(&b"\x01\0\0\0=".repeat(101)).unwrap_err(),
        HeaderError::TooManyFields
    );
    let error = publication(TopicType::any()).answer(&ConnectionHeader::default()).unwrap_err();
    assert_eq!(error, HandshakeError::Header(HeaderError::Missing { name: "topic" }));
}

#[test]
fn value_keeps_later_separators() {
    let header = encode_and_decode(&ConnectionHeader::from_fields([("message_definition", "uint8 A=1\n")]));
    assert_eq!(header.get("message_definition"), Some("uint8 A=1\n"));
}

#[test]
fn too_long_definition_is_omitted() {
    let long_definition = "x".repeat(MAX_HEADER_BYTES);
    let header = encode_and_decode(&ConnectionHeader::from_fields([
        ("message_definition", &*long_definition),
        ("topic", "/t"),
    ]));
    assert_eq!(header, ConnectionHeader::from_fields([("topic", "/t")]));
}

#[test]
fn claimed_length_reserves_memory_gradually() {
    let mut buffer = FrameBuffer::new(64 * 1024 * 1024);
    buffer.input().unwrap().put_slice(&50_000_000_u32.to_le_bytes());
    assert!(buffer.next_frame().unwrap().is_none());
    assert!(buffer.input().unwrap().get_ref().capacity() < 200_000);
    buffer.input().unwrap().put_bytes(0, 60_000);
    assert!(buffer.input().unwrap().get_ref().capacity() < 2_000_000);
}

#[test]
fn too_long_frame_is_refused() {
    let mut buffer = FrameBuffer::new(10);
    buffer.input().unwrap().put_slice(&11_u32.to_le_bytes());
    assert_eq!(buffer.next_frame().unwrap_err(), FrameError::TooLong { length: 11, max: 10 });
}

#[test]
fn frames_reserve_memory_for_arrived_bytes_only() {
    let limit = TestLimit::new(1_000_000);
    let new_buffer = || {
        let mut buffer = FrameBuffer::new(0);
        buffer.set_limits(&MessageLimits { max_bytes: 64 * 1024 * 1024, memory: limit.to_memory_limit() });
        buffer
    };
    // These connections claim long frames and send few bytes.
    let mut claiming_buffers: Vec<FrameBuffer> = (0..8).map(|_| new_buffer()).collect();
    for buffer in &mut claiming_buffers {
        buffer.input().unwrap().put_slice(&50_000_000_u32.to_le_bytes());
        assert!(buffer.next_frame().unwrap().is_none());
        assert!(buffer.input().is_ok());
    }
    let reserved_by_claims = limit.reserved();
    assert!(reserved_by_claims <= 8 * 64 * 1024, "{reserved_by_claims} bytes");
    let mut honest_buffer = new_buffer();
    honest_buffer.input().unwrap().put_slice(&200_000_u32.to_le_bytes());
    let (frame, memory) = loop {
        if let Some(frame) = honest_buffer.next_frame().unwrap() {
            break frame;
        }
        let mut input = honest_buffer.input().unwrap();
        let capacity = input.remaining_mut();
        input.put_bytes(7, capacity.min(60_000));
    };
    assert_eq!((frame.len(), limit.reserved()), (200_000, reserved_by_claims + 200_004));
    drop(memory);
    assert_eq!(limit.reserved(), reserved_by_claims);
    // One of the connections sends the claimed bytes, until the limit is reached.
    let error = loop {
        match claiming_buffers[0].input() {
            Ok(mut input) => {
                let capacity = input.remaining_mut();
                input.put_bytes(7, capacity);
            }
            Err(error) => break error,
        }
    };
    assert_eq!(error, FrameError::NoMemory { length: 50_000_000 });
    drop(claiming_buffers);
    assert_eq!(limit.reserved(), 0);
}

proptest! {
    #[test]
    fn any_header_is_read_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = ConnectionHeader::decode(&bytes);
    }

    #[test]
    fn header_decodes_to_encoded_value(fields in proptest::collection::btree_map("[a-z0-9_]{0,9}", ".{0,30}", 0..9)) {
        let header = ConnectionHeader::from_fields(fields.iter().map(|(name, value)| (&**name, &**value)));
        prop_assert_eq!(encode_and_decode(&header), header);
    }

    #[test]
    fn frames_are_read_from_any_chunks(
        frames in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..300), 0..8),
        long_frame_bytes in 0_usize..200_000,
        reads in proptest::collection::vec(1_usize..90_000, 1..9),
    ) {
        let mut expected: Vec<Bytes> = frames.into_iter().map(Bytes::from).collect();
        expected.insert(expected.len() / 2, vec![7; long_frame_bytes].into());
        let mut stream = Vec::new();
        for frame in &expected {
            stream.put_u32_le(u32::try_from(frame.len()).unwrap());
            stream.put_slice(frame);
        }
        let mut buffer = FrameBuffer::new(1_000_000);
        let mut received = Vec::new();
        let (mut remaining, mut reads) = (&stream[..], reads.iter().cycle());
        while !remaining.is_empty() {
            // Like a read from a socket, the input takes at most as many bytes as fit.
            let mut input = buffer.input().unwrap();
            let capacity = input.remaining_mut();
            prop_assert!(capacity > 0);
            let count = remaining.len().min(*reads.next().unwrap()).min(capacity);
            input.put_slice(&remaining[..count]);
            remaining = &remaining[count..];
            while let Some((frame, _)) = buffer.next_frame().unwrap() {
                received.push(frame);
            }
        }
        prop_assert_eq!(received, expected);
        prop_assert!(!buffer.has_partial_frame());
    }
}
