//! Check with arbitrary bytes as the stream of an answer, for the fuzz target in `fuzz/` and for tests.

use peernet_clock::MonoTime;

use super::answer::StreamedAnswer;

/// Checks that an answer does not depend on how its stream is divided: receives the bytes once in pieces and once as a
/// whole. The value of the first byte, plus one, is the length of a piece.
///
/// # Panics
/// If the two answers differ, or if the text of the answer is not the concatenation of the texts that were passed to
/// `receive_text`.
pub fn check_stream(data: &[u8]) {
    let Some((&first_byte, data)) = data.split_first() else { return };
    let mut in_pieces = StreamedAnswer::new(MonoTime::from_nanos(0));
    let mut passed_text = String::new();
    let mut pieces = data.chunks(usize::from(first_byte) + 1).zip(0..);
    let result = pieces.try_for_each(|(piece, at)| {
        in_pieces.receive(MonoTime::from_nanos(at), piece, |text| passed_text.push_str(text))
    });
    assert_eq!(in_pieces.text, passed_text);
    let mut whole = StreamedAnswer::new(MonoTime::from_nanos(0));
    let whole_result = whole.receive(MonoTime::from_nanos(0), data, |_| ());
    assert_eq!(result, whole_result);
    assert_eq!(in_pieces.text, whole.text);
    assert_eq!((in_pieces.usage, &in_pieces.finish_reason), (whole.usage, &whole.finish_reason));
    assert_eq!((in_pieces.chunk_count(), in_pieces.is_done()), (whole.chunk_count(), whole.is_done()));
    assert_eq!(in_pieces.chunk_intervals().len() as u64 + 1, in_pieces.chunk_count().max(1));
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn fuzz_corpus_breaks_no_invariant() {
        let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus/answer_stream");
        let files: Vec<_> = std::fs::read_dir(corpus).expect("is committed").collect();
        assert!(files.len() >= 4);
        for file in files {
            check_stream(&std::fs::read(file.expect("is readable").path()).expect("is readable"));
        }
    }

    proptest! {
        #[test]
        fn random_streams_break_no_invariant(first_byte: u8, events in proptest::collection::vec(prop_oneof![
            Just("data: {\"choices\":[{\"delta\":{\"content\":\"漢 a\"}}]}\n\n"),
            Just("data: {\"choices\":[{\"delta\":{\"reasoning\":\"b\"},\"finish_reason\":\"stop\"}]}\r\n\r\n"),
            Just("data: {\"choices\":[],\"usage\":{\"completion_tokens\":7}}\n\n"),
            Just("data: {\"error\":\"no\"}\n\n"),
            Just("event: error\n"),
            Just("error: {}\n\n"),
            Just("data: {\"detail\":[]}\n\n"),
            Just("data: {\"choices\":[{\"index\":\"0\",\"text\":\"a\"},{\"index\":-1,\"delta\":{\"content\":\"b\"}}]}\n\n"),
            Just("data: [DONE]\n\n"),
            Just(": ping\n\n"),
            Just("data: {\n"),
        ], 0..20)) {
            check_stream(&[&[first_byte], events.concat().as_bytes()].concat());
        }

        #[test]
        fn random_bytes_break_no_invariant(data in proptest::collection::vec(any::<u8>(), 0..200)) {
            check_stream(&data);
        }
    }
}
