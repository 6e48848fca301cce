//! Functions that pass arbitrary bytes to the parsers of network data, for the fuzz targets in `fuzz/` and for a test.

use bytes::{BufMut, Bytes};

use crate::messages::{
    CompressedImage, Image, Imu, Message, MessageInfo, PointCloud2, SessionHello, StringMessage,
    UInt8MultiArray, WireForm,
};
use crate::ros1::TopicType;
use crate::ros1::tcpros::{ConnectionHeader, FrameBuffer, Publication, Subscription};
use crate::ros1::xmlrpc::{parse_call, parse_response, write_call, write_response};

/// Longest frame in [`any_connection`], bytes.
const MAX_FRAME_BYTES: usize = 64 * 1024;

/// Parses the bytes as a call and as a response of XML-RPC.
///
/// # Panics
/// If a call or response that was read cannot be written and read again.
pub fn any_xml_rpc(data: &[u8]) {
    if let Ok(call) = parse_call(data) {
        parse_call(write_call(&call).as_bytes()).expect("a written call can be read");
    }
    if let Ok(response) = parse_response(data) {
        parse_response(write_response(&response).as_bytes()).expect("a written response can be read");
    }
}

/// Feeds the bytes to a TCPROS connection. The value of the first byte, plus one, is the number of bytes that arrive at
/// a time. Each frame is parsed as a subscriber's header and as a publisher's header.
///
/// # Panics
/// If more than four times the limit of a frame is reserved, or a header that was read cannot be sent.
pub fn any_connection(data: &[u8]) {
    let Some((&step, data)) = data.split_first() else { return };
    let publication = Publication {
        node: "/publisher".into(),
        topic: "/topic".into(),
        kind: TopicType::from_message::<StringMessage>(),
        is_latching: false,
    };
    let subscription = Subscription {
        node: "/subscriber".into(),
        topic: "/topic".into(),
        kind: TopicType::from_message::<StringMessage>(),
    };
    let mut buffer = FrameBuffer::new(MAX_FRAME_BYTES);
    let mut remaining = data;
    while !remaining.is_empty() {
        let mut input = buffer.input().expect("there is no memory limit");
        let count = remaining.len().min(usize::from(step) + 1).min(input.remaining_mut());
        input.put_slice(&remaining[..count]);
        remaining = &remaining[count..];
        let capacity = input.get_ref().capacity();
        assert!(capacity <= 4 * MAX_FRAME_BYTES, "{capacity} bytes");
        loop {
            let frame = match buffer.next_frame() {
                Ok(Some((frame, _))) => frame,
                Ok(None) => break,
                Err(_) => return,
            };
            let Ok(header) = ConnectionHeader::decode(&frame) else { continue };
            assert_eq!(ConnectionHeader::decode(&header.encode()[4..]).as_ref(), Ok(&header));
            // Both acceptance and refusal are correct. Only a panic is a failure.
            let _ = subscription.accept(&header);
            let error = match publication.answer(&header) {
                Ok(_) => continue,
                Err(error) => error.to_string(),
            };
            ConnectionHeader::decode(&ConnectionHeader::error(&error).encode()[4..])
                .expect("an error is a header");
        }
    }
}

/// Parses the bytes as a message of each type in both wire forms.
///
/// # Panics
/// If a ROS 1 message is not written with the length that was read.
pub fn any_message(data: &[u8]) {
    fn read<M: Message>(form: WireForm, data: &Bytes) {
        let Ok(message) = M::decode(form, data.clone()) else { return };
        // A text in CDR may have a NUL before its end. The message is then read but cannot be encoded.
        if let Ok(encoded) = message.encode(form) {
            // In CDR the lengths may differ: an empty text may lack its NUL, and padding may follow each text.
            assert!(form == WireForm::Cdr || encoded.len() == data.len());
        }
    }
    let data = Bytes::copy_from_slice(data);
    for form in [WireForm::Ros1, WireForm::Cdr] {
        read::<StringMessage>(form, &data);
        read::<Image>(form, &data);
        read::<CompressedImage>(form, &data);
        read::<Imu>(form, &data);
        read::<PointCloud2>(form, &data);
        read::<UInt8MultiArray>(form, &data);
        read::<SessionHello>(form, &data);
        read::<MessageInfo>(form, &data);
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use super::{any_connection, any_message, any_xml_rpc};

    /// A fuzz target: the name of its corpus, and its function.
    type Target = (&'static str, fn(&[u8]));

    const TARGETS: [Target; 3] =
        [("xml_rpc", any_xml_rpc), ("ros1_connection", any_connection), ("ros_message", any_message)];

    fn corpus(name: &str) -> Vec<Vec<u8>> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus").join(name);
        let entries = folder.read_dir().expect("the corpus is in the checkout");
        entries.map(|entry| std::fs::read(entry.unwrap().path()).unwrap()).collect()
    }

    #[test]
    fn corpora_are_read_without_panic() {
        for (name, run) in TARGETS {
            let corpus = corpus(name);
            assert!(!corpus.is_empty(), "{name}");
            corpus.iter().for_each(|data| run(data));
        }
    }

    /// Inputs of all corpora, each with the function of its target.
    fn inputs() -> impl Strategy<Value = (fn(&[u8]), Vec<u8>)> {
        let pairs = |(name, run): Target| corpus(name).into_iter().map(move |data| (run, data));
        proptest::sample::select(TARGETS.into_iter().flat_map(pairs).collect::<Vec<_>>())
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_without_panic(data in proptest::collection::vec(any::<u8>(), 0..400)) {
            TARGETS.into_iter().for_each(|(_, run)| run(&data));
        }

        #[test]
        fn damaged_corpora_are_read_without_panic(
            (run, mut data) in inputs(),
            changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4_u8), 1..8),
        ) {
            for (index, byte, change) in changes {
                let index = index.index(data.len() + 1);
                match change {
                    0 => data.insert(index, byte),
                    1 => data.truncate(index),
                    2 => data.extend_from_within(index..),
                    _ if index < data.len() => data[index] = byte,
                    _ => {}
                }
            }
            run(&data);
        }
    }
}
