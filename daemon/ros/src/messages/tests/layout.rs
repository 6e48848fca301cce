//! Tests of the exact bytes of messages.

use bytes::Bytes;

use crate::messages::{
    CompressedImage, DecodeError, EncodeError, Header, Message, StringMessage, Time, WireForm,
};

fn picture() -> CompressedImage {
    CompressedImage {
        header: Header { seq: 7, stamp: Time { sec: 1, nanosec: 2 }, frame_id: "cam".into() },
        format: "jpeg".into(),
        data: Bytes::from_static(&[0xff, 0xd8]),
    }
}

#[test]
fn ros1_message_has_no_padding() {
    let bytes = picture().encode(WireForm::Ros1).unwrap().into_bytes();
    let expected = b"\x07\0\0\0\x01\0\0\0\x02\0\0\0\x03\0\0\0cam\x04\0\0\0jpeg\x02\0\0\0\xff\xd8";
    assert_eq!(&bytes[..], &expected[..]);
}

#[test]
fn cdr_message_is_aligned_and_has_nuls() {
    let bytes = picture().encode(WireForm::Cdr).unwrap().into_bytes();
    let expected = b"\0\x01\0\0\x01\0\0\0\x02\0\0\0\x04\0\0\0cam\0\x05\0\0\0jpeg\0\0\0\0\x02\0\0\0\xff\xd8";
    assert_eq!(&bytes[..], &expected[..]);
}

#[test]
fn big_endian_cdr_is_read() {
    let bytes = b"\0\0\0\0\0\0\0\x01\0\0\0\x02\0\0\0\x04cam\0\0\0\0\x05jpeg\0\0\0\0\0\0\0\x02\xff\xd8\0\0";
    let decoded = CompressedImage::decode(WireForm::Cdr, Bytes::from_static(bytes)).unwrap();
    let mut expected = picture();
    expected.header.seq = 0;
    assert_eq!(decoded, expected);
}

#[test]
fn long_data_is_not_copied() {
    let data = Bytes::from(vec![5; 100_000]);
    let image = CompressedImage { data: data.clone(), ..picture() };
    let encoded = image.encode(WireForm::Ros1).unwrap();
    assert_eq!(encoded.segments().last().unwrap().as_ptr(), data.as_ptr());
    let message_bytes = encoded.into_bytes();
    let decoded = CompressedImage::decode(WireForm::Ros1, message_bytes.clone()).unwrap();
    assert_eq!(decoded.data.as_ptr(), message_bytes[message_bytes.len() - 100_000..].as_ptr());
}

#[test]
fn empty_cdr_text_may_have_length_zero() {
    let decoded = StringMessage::decode(WireForm::Cdr, Bytes::from_static(b"\0\x01\0\0\0\0\0\0")).unwrap();
    assert_eq!(decoded.data, "");
}

#[test]
fn values_outside_the_wire_form_are_refused() {
    let header_before_1970 = Header { stamp: Time { sec: -1, nanosec: 0 }, ..Header::default() };
    assert_eq!(
        header_before_1970.encode(WireForm::Ros1).unwrap_err(),
        EncodeError::TimeOutOfRange { seconds: -1 }
    );
    assert!(header_before_1970.encode(WireForm::Cdr).is_ok());
    let text = StringMessage { data: "a\0b".into() };
    assert_eq!(text.encode(WireForm::Cdr).unwrap_err(), EncodeError::NulInText { text: "a\0b".into() });
    assert!(text.encode(WireForm::Ros1).is_ok());
}

#[test]
fn claimed_length_is_compared_with_remaining_bytes() {
    let bytes = Bytes::from_static(b"\xff\xff\xff\xffabc");
    let error = StringMessage::decode(WireForm::Ros1, bytes).unwrap_err();
    assert_eq!(error, DecodeError::TooShort { offset: 4, needed: 0xffff_ffff, available: 3 });
}

#[test]
fn malformed_messages_are_refused() {
    let decode =
        |form, bytes: &'static [u8]| StringMessage::decode(form, Bytes::from_static(bytes)).unwrap_err();
    assert_eq!(decode(WireForm::Ros1, b"\0\0\0\0x"), DecodeError::TrailingBytes { count: 1 });
    assert_eq!(decode(WireForm::Cdr, b"\0\x01\0\0\x01\0\0\0x"), DecodeError::UnterminatedText { offset: 4 });
    assert_eq!(decode(WireForm::Ros1, b"\x01\0\0\0\xff"), DecodeError::NotUtf8 { offset: 0 });
    assert_eq!(decode(WireForm::Cdr, b"\0\x03\0\0"), DecodeError::Encapsulation { first: 0, second: 3 });
}

#[test]
fn time_converts_to_nanoseconds_and_back() {
    for nanos in [0, 1, -1, 1_700_000_000_123_456_789, i64::MAX] {
        assert_eq!(Time::from_nanos(nanos).as_nanos(), nanos);
    }
    assert_eq!(Time::from_nanos(-1), Time { sec: -1, nanosec: 999_999_999 });
}
