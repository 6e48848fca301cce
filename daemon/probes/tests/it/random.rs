//! Tests of the prober and the reflector with arbitrary bytes, and with the corpus of the fuzz target.

use std::path::Path;

use peernet_probes::fuzzing::any_packet;
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn any_bytes_are_read_without_panic(data: Vec<u8>) {
        any_packet(&data);
    }

    /// Bytes of the length of a packet, with TLVs of plausible types and lengths.
    #[test]
    fn damaged_packets_are_read_without_panic(
        options: u8,
        base in proptest::collection::vec(any::<u8>(), 112),
        tlvs in proptest::collection::vec((any::<u8>(), prop_oneof![Just(1u8), Just(7), Just(8), Just(252), any::<u8>()], 0u16..40, 0usize..40), 0..8),
        // In half of the cases, nothing is cut off.
        cut_bytes in (0usize..100).prop_map(|bytes| bytes.saturating_sub(50)),
    ) {
        let mut data = vec![options];
        // Bit 0 of the options selects the mode with a key, whose base packet has 112 bytes instead of 44.
        data.extend(if options & 1 == 0 { &base[..44] } else { &base[..] });
        for (flags, kind, length, bytes) in tlvs {
            data.extend([flags, kind]);
            data.extend(length.to_be_bytes());
            // Most TLVs have the length that they claim.
            let bytes = if bytes < 30 { usize::from(length) } else { bytes };
            data.extend(vec![flags; bytes]);
        }
        data.truncate(data.len().saturating_sub(cut_bytes));
        any_packet(&data);
    }
}

#[test]
fn fuzz_corpus_passes() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus/packet");
    let entries = std::fs::read_dir(&corpus).expect("fuzz/corpus/packet is part of the checkout");
    let mut file_count = 0;
    for entry in entries {
        any_packet(&std::fs::read(entry.expect("readable").path()).expect("readable"));
        file_count += 1;
    }
    assert!(file_count >= 10, "only {file_count} files in {}", corpus.display());
}
