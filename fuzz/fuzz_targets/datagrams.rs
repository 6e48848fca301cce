//! Any datagrams at a cloud's port, with time passing in between.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_networks::datagram::fuzzing::run_datagram_script(data));
