//! Anything said to either end of the event stream, in any order.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_stream::fuzzing::any_conversation(data));
