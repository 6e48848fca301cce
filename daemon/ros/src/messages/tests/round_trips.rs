//! Tests of round trips: decoding returns the encoded value in both wire forms.

use std::fmt::Debug;

use proptest::prelude::*;

use super::{byte_strings, compressed_images, headers, images, imus, point_clouds};
use crate::messages::{
    Header, Message, MultiArrayDimension, MultiArrayLayout, StringMessage, UInt8MultiArray, WireForm,
};

fn encode_and_decode<M: Message>(message: &M, form: WireForm) -> M {
    let encoded = message.encode(form).unwrap();
    let length = encoded.len();
    let bytes = encoded.into_bytes();
    assert_eq!(bytes.len(), length);
    M::decode(form, bytes).unwrap()
}

/// Asserts that a message survives encoding and decoding in both forms. `without_seq` removes the field that ROS 2 does
/// not have.
fn assert_round_trips<M: Message + PartialEq + Debug>(message: M, without_seq: impl FnOnce(M) -> M) {
    assert_eq!(encode_and_decode(&message, WireForm::Ros1), message);
    let decoded = encode_and_decode(&message, WireForm::Cdr);
    assert_eq!(decoded, without_seq(message));
}

fn clear_seq(header: Header) -> Header {
    Header { seq: 0, ..header }
}

proptest! {
    #[test]
    fn header_decodes_to_encoded_value(message in headers()) {
        assert_round_trips(message, clear_seq);
    }

    #[test]
    fn string_decodes_to_encoded_value(data in "[^\0]{0,100}") {
        assert_round_trips(StringMessage { data }, |message| message);
    }

    #[test]
    fn byte_array_decodes_to_encoded_value(label in "[^\0]{0,9}", size: u32, stride: u32, data_offset: u32, data in byte_strings()) {
        let layout = MultiArrayLayout { dim: vec![MultiArrayDimension { label, size, stride }], data_offset };
        assert_round_trips(UInt8MultiArray { layout, data }, |message| message);
    }

    #[test]
    fn image_decodes_to_encoded_value(message in images()) {
        assert_round_trips(message, |mut m| { m.header = clear_seq(m.header); m });
    }

    #[test]
    fn compressed_image_decodes_to_encoded_value(message in compressed_images()) {
        assert_round_trips(message, |mut m| { m.header = clear_seq(m.header); m });
    }

    #[test]
    fn imu_decodes_to_encoded_value(message in imus()) {
        assert_round_trips(message, |mut m| { m.header = clear_seq(m.header); m });
    }

    #[test]
    fn point_cloud_decodes_to_encoded_value(message in point_clouds()) {
        assert_round_trips(message, |mut m| { m.header = clear_seq(m.header); m });
    }
}
