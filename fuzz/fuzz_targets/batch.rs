//! Any bytes as a batch of the event stream.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_stream::fuzzing::any_batch(data));
