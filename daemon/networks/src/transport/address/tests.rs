//! Tests of the addresses of networks.

use std::net::Ipv4Addr;

use peernet_stream::NetworkName;
use proptest::prelude::*;

use super::*;

#[test]
fn addresses_parse_from_their_text() {
    for text in [
        "tcp://127.0.0.1:5551",
        "tcp://[::1]:0",
        "tcp://cloud-1.lab:65535",
        "tcp://[fe80::1]:80",
        "tcp://a:1",
    ] {
        assert_eq!(text.parse::<Address>().expect(text).to_string(), text);
    }
}

#[test]
fn invalid_addresses_are_refused_with_the_reason() {
    for (text, problem) in [
        ("cloud:5551", "the scheme is missing"),
        ("pgm://cloud:5551", "unknown scheme \"pgm\""),
        ("tcp://cloud", "the port is missing"),
        ("tcp://:5551", "the host is missing"),
        ("tcp://cloud:", "\"\" is not a port"),
        ("tcp://cloud:+1", "\"+1\" is not a port"),
        ("tcp://cloud:65536", "port 65536 is above 65535"),
        ("tcp://::1:5551", "an IPv6 host needs brackets"),
        ("tcp://[::1:5551", "the closing bracket is missing"),
        ("tcp://[cloud]:5551", "\"cloud\" is not an IPv6 address"),
        ("tcp://256.0.0.1:5551", "\"256.0.0.1\" is not an IPv4 address"),
        ("tcp://a b:5551", "\"a b\" is not a host name"),
    ] {
        assert_eq!(text.parse::<Address>().expect_err(text).problem.to_string(), problem);
    }
}

#[test]
fn error_proposes_form_of_given_scheme() {
    let advice = |text: &str| {
        let message = text.parse::<Address>().expect_err(text).to_string();
        message.split_once("; write ").expect("the message says what to write").1.to_owned()
    };
    assert_eq!(advice("tcp://10.0.0.2"), "tcp://host:port, IPv6 hosts in brackets");
    assert_eq!(advice("udp://10.0.0.2"), "udp://host:port, IPv6 hosts in brackets");
    assert_eq!(advice("ros2://x/name"), "ros2://domain/name");
    for text in ["10.0.0.2:5551", "pgm://10.0.0.2:5551"] {
        let forms = advice(text);
        assert!(forms.contains("tcp://host:port") && forms.contains("ros1://host:port/name"), "{forms}");
    }
    for text in ["tcp://10.0.0.2", "10.0.0.2:5551", "ros1://a:b/name", "udp://10.0.0.2"] {
        let message = InvalidEventStreamAddress(text.parse::<Address>().expect_err(text)).to_string();
        assert!(message.ends_with("; write tcp://host:port, IPv6 hosts in brackets"), "{message}");
    }
}

#[test]
fn every_scheme_selects_its_network() {
    for network in NetworkKind::ALL {
        assert_eq!(NetworkName::from(*network).as_str(), network.name());
        for scheme in network.schemes() {
            let is_in_domain = network.address_form().placeholder(scheme).starts_with("domain");
            let authority = if is_in_domain { "1" } else { "cloud:1" };
            let address: Address = format!("{scheme}://{authority}").parse().expect("a scheme");
            assert_eq!((address.network(), address.scheme()), (*network, *scheme));
            assert_eq!(address.check_network(Some(*network)), Ok(()));
            assert_eq!(address.check_network(None), Ok(()));
            let bound = address.with_ip(IpAddr::V4(Ipv4Addr::LOCALHOST), 7);
            let name = address.listener_name().map_or_else(String::new, |name| format!("/{name}"));
            assert_eq!(bound.to_string(), format!("{scheme}://127.0.0.1:7{name}"));
        }
    }
    assert_eq!(Address::from_ip(IpAddr::V4(Ipv4Addr::LOCALHOST), 7).to_string(), "tcp://127.0.0.1:7");
}

#[test]
fn named_listeners_have_default_port_and_name() {
    for (text, address) in [
        ("ros1://robot", "ros1://robot:11311/peernet"),
        ("ros1://robot:7/", "ros1://robot:7/peernet"),
        ("ros1://[::1]/gpu_1", "ros1://[::1]:11311/gpu_1"),
        ("ros1://10.0.0.1:11311/gpu", "ros1://10.0.0.1:11311/gpu"),
    ] {
        assert_eq!(text.parse::<Address>().expect(text).to_string(), address);
    }
    for (text, address) in [("ros2://7", "ros2://7/peernet"), ("ros2://232/gpu_1", "ros2://232/gpu_1")] {
        let read: Address = text.parse().expect(text);
        assert_eq!((read.to_string().as_str(), read.ros_domain().is_some()), (address, true));
    }
    for (wrong, domain) in [("ros2://233", "233"), ("ros2://+1/a", "+1"), ("ros2://robot:1/a", "robot:1")] {
        let error = wrong.parse::<Address>().expect_err(wrong).to_string();
        assert!(
            error.contains(&format!("{domain:?} is not a domain")) && error.contains("ros2://domain/name"),
            "{error}"
        );
    }
    for wrong in ["ros1://", "ros1:///gpu", "ros1://robot/a-b", "ros1://robot/a/b", "tcp://robot:7/gpu"] {
        assert!(wrong.parse::<Address>().is_err(), "{wrong}");
    }
}

proptest! {
    #[test]
    fn text_of_address_parses_to_same_address(text in "((tcp|ros1|ros2)://)?[a-z0-9./:\\[\\]-]{0,24}") {
        if let Ok(address) = text.parse::<Address>() {
            prop_assert_eq!(address.to_string().parse::<Address>(), Ok(address));
        }
    }
}
