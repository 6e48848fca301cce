//! The framing of libzmq's RADIO and DISH sockets over UDP: length of the group, group, body.

/// The group of all datagrams, preceded by its length.
pub(super) const PREFIX: &[u8] = b"\x07peernet";

/// Largest datagram that libzmq sends and receives (`MAX_UDP_MSG`). Bytes.
pub(super) const MAX_DATAGRAM_BYTES: u16 = 8_192;

/// Returns the body of a datagram, which may be empty; `None` if the datagram has no group or another group.
pub(super) fn body(datagram: &[u8]) -> Option<&[u8]> {
    datagram.strip_prefix(PREFIX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn length_of_group_is_first_byte() {
        let (length, group) = PREFIX.split_first().expect("not empty");
        assert_eq!((usize::from(*length), group), (group.len(), &b"peernet"[..]));
        assert_eq!(body(b"\x07peernetbody"), Some(&b"body"[..]));
        assert_eq!(body(b"\x07peernet"), Some(&b""[..]));
        for other in [&b""[..], b"\x07peerne", b"\x08peernet2body", b"\x06peernetbody"] {
            assert_eq!(body(other), None);
        }
    }
}
