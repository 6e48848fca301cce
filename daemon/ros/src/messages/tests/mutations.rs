//! Tests with damaged messages. A damaged message is refused or read as another message, and never causes a panic.

use bytes::Bytes;
use proptest::prelude::*;
use proptest::sample::Index;

use super::{compressed_images, images, imus, point_clouds};
use crate::messages::{
    CompressedImage, Image, Imu, Message, PointCloud2, StringMessage, UInt8MultiArray, WireForm,
};

/// Decodes the bytes as every type, and encodes every accepted message again.
fn decode_all(form: WireForm, bytes: &Bytes) {
    fn decode<M: Message>(form: WireForm, bytes: &Bytes) {
        if let Ok(message) = M::decode(form, bytes.clone()) {
            // A text of CDR may have a NUL before its end. The message is then read but cannot be encoded.
            let _ = message.encode(form);
        }
    }
    decode::<StringMessage>(form, bytes);
    decode::<Image>(form, bytes);
    decode::<CompressedImage>(form, bytes);
    decode::<Imu>(form, bytes);
    decode::<PointCloud2>(form, bytes);
    decode::<UInt8MultiArray>(form, bytes);
}

fn mutate(mut bytes: Vec<u8>, changes: &[(Index, u8)], length: Option<Index>) -> Bytes {
    for (index, value) in changes {
        if !bytes.is_empty() {
            let index = index.index(bytes.len());
            bytes[index] = *value;
        }
    }
    if let Some(length) = length {
        bytes.truncate(length.index(bytes.len() + 1));
    }
    bytes.into()
}

fn forms() -> impl Strategy<Value = WireForm> {
    prop_oneof![Just(WireForm::Ros1), Just(WireForm::Cdr)]
}

fn encoded_messages() -> impl Strategy<Value = (WireForm, Vec<u8>)> {
    fn bytes<M: Message>(message: &M, form: WireForm) -> (WireForm, Vec<u8>) {
        (form, message.encode(form).unwrap().into_bytes().into())
    }
    prop_oneof![
        (images(), forms()).prop_map(|(message, form)| bytes(&message, form)),
        (compressed_images(), forms()).prop_map(|(message, form)| bytes(&message, form)),
        (imus(), forms()).prop_map(|(message, form)| bytes(&message, form)),
        (point_clouds(), forms()).prop_map(|(message, form)| bytes(&message, form)),
    ]
}

proptest! {
    #[test]
    fn any_bytes_are_read_without_panic(form in forms(), bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        decode_all(form, &bytes.into());
    }

    #[test]
    fn damaged_messages_are_read_without_panic(
        (form, bytes) in encoded_messages(),
        changes in proptest::collection::vec((any::<Index>(), any::<u8>()), 0..6),
        length: Option<Index>,
    ) {
        decode_all(form, &mutate(bytes, &changes, length));
    }
}
