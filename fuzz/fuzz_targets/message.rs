//! Any bytes as a message between an agent and the aggregator.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_stream::fuzzing::any_message(data));
