//! Any bytes as a call and a response of XML-RPC.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_ros::fuzzing::any_xml_rpc(data));
