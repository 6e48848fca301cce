//! Any bytes as the streamed answer of a language model.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_inference::model::openai::fuzzing::check_stream(data));
