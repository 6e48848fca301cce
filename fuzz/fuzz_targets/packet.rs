//! Any bytes as a probe's packet, at the reflector and at the sender.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_probes::fuzzing::any_packet(data));
