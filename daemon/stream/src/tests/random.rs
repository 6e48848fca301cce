//! Random input to both ends, and the corpus of the fuzz targets.

use std::path::Path;

use proptest::prelude::*;

use crate::fuzzing::{any_batch, any_conversation, any_message};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn any_bytes_cause_no_panic(data: Vec<u8>) {
        any_batch(&data);
        any_message(&data);
    }

    #[test]
    fn any_conversation_causes_no_panic(data in prop::collection::vec(any::<u8>(), 0..600)) {
        any_conversation(&data);
    }
}

#[test]
fn corpus_of_fuzz_targets_causes_no_panic() {
    for name in ["batch", "message", "conversation"] {
        let target = match name {
            "batch" => any_batch,
            "message" => any_message,
            _ => any_conversation,
        };
        let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus").join(name);
        let entries = std::fs::read_dir(&corpus).expect("the corpus is part of the checkout");
        let mut file_count = 0;
        for entry in entries {
            let path = entry.expect("the corpus can be listed").path();
            target(&std::fs::read(path).expect("a file of the corpus can be read"));
            file_count += 1;
        }
        assert!(file_count >= 3, "only {file_count} files in {}", corpus.display());
    }
}
