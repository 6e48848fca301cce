//! Arbitrary bytes as the stream of an answer, for the fuzz target in `fuzz/` and for a test.

use peernet_clock::MonoTime;

use super::answer::StreamedAnswer;

/// Receives the bytes as the stream of an answer, once in pieces and once as a whole. A piece has as many bytes as the
/// first byte says, plus one.
///
/// # Panics
/// If the pieces change the answer, or the texts that were passed on are not its text.
pub fn any_stream(data: &[u8]) {
    let Some((&step, data)) = data.split_first() else { return };
    let mut in_pieces = StreamedAnswer::new(MonoTime::from_nanos(0));
    let mut passed_on = String::new();
    let mut pieces = data.chunks(usize::from(step) + 1).zip(0..);
    let result = pieces.try_for_each(|(piece, at)| {
        in_pieces.receive(MonoTime::from_nanos(at), piece, |text| passed_on.push_str(text))
    });
    assert_eq!(in_pieces.text, passed_on);
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
            any_stream(&std::fs::read(file.expect("is readable").path()).expect("is readable"));
        }
    }

    proptest! {
        #[test]
        fn random_streams_break_no_invariant(step: u8, events in proptest::collection::vec(prop_oneof![
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
            any_stream(&[&[step], events.concat().as_bytes()].concat());
        }

        #[test]
        fn random_bytes_break_no_invariant(data in proptest::collection::vec(any::<u8>(), 0..200)) {
            any_stream(&data);
        }
    }
}
