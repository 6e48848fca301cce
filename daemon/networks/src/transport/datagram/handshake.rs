//! Opening of a virtual connection, without I/O.
//!
//! An edge sends a hello. The cloud answers with a cookie and keeps no state. An edge that returns the cookie has shown
//! that it receives what is sent to its address, and gets a connection. Before that, no answer is longer than the
//! request. A sender that forges its address therefore cannot make a cloud send more bytes to that address than the
//! sender sends, and cannot fill the cloud's memory. RFC 9147, section 5.1, describes the same protection.

use std::net::{IpAddr, SocketAddr};

use hmac::{Hmac, KeyInit, Mac};
use peernet_clock::{MonoTime, Span};
use sha2::Sha256;

use super::MIN_DATAGRAM_BYTES;
use super::packet::{Cookie, Packet, ResetReason, Role, Terms, VERSION};

/// Largest datagram that every path is assumed to carry: together with its headers, it is shorter than IPv6's minimum
/// MTU of 1,280 bytes.
pub(crate) const SAFE_DATAGRAM_BYTES: u16 = 1_200;

/// Shortest time for which a cookie is accepted. The longest is twice that, because cookies of the previous period are
/// accepted, too.
pub(super) const COOKIE_LIFETIME: Span = Span::from_seconds(10);

/// Time until the first repetition of a packet without an answer. The interval doubles with each repetition, up to
/// eight times this value.
const RETRY_INTERVAL: Span = Span::from_millis(100);

/// Maximum number of unanswered requests with large datagrams. A small datagram is tried afterwards.
const MAX_LARGE_ATTEMPTS: u32 = 3;

/// Maximum number of unanswered requests with small datagrams and the same cookie. These requests take about five
/// seconds, which is less than the lifetime of a cookie.
const MAX_ATTEMPTS: u32 = 8;

/// The secret with which a cloud makes cookies and connection numbers.
pub(crate) struct CookieKey([u8; 32]);

impl std::fmt::Debug for CookieKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("CookieKey")
    }
}

impl CookieKey {
    pub(crate) const fn new(secret: [u8; 32]) -> Self {
        Self(secret)
    }

    /// Returns the cookie of an address and a nonce.
    pub(crate) fn cookie(&self, address: SocketAddr, nonce: u64, now: MonoTime) -> Cookie {
        self.cookie_at(address, nonce, period(now))
    }

    /// Returns whether this is the cookie of an address and a nonce and is not too old.
    pub(crate) fn is_valid_cookie(
        &self,
        cookie: &Cookie,
        address: SocketAddr,
        nonce: u64,
        now: MonoTime,
    ) -> bool {
        // A cookie of the previous period is valid, too, so that a cookie from the end of a period can still be used.
        [period(now), period(now) - 1].iter().any(|period| self.cookie_at(address, nonce, *period) == *cookie)
    }

    /// Returns an unpredictable number for a connection.
    pub(crate) fn connection_number(&self, count: u64) -> u64 {
        // A sender that does not receive the cloud's packets must not be able to guess the number of a connection.
        first_u64(&self.mac(b"connection", &[&count.to_be_bytes()]))
    }

    fn cookie_at(&self, address: SocketAddr, nonce: u64, period: i64) -> Cookie {
        let ip = match address.ip() {
            IpAddr::V4(ip) => ip.to_ipv6_mapped(),
            IpAddr::V6(ip) => ip,
        };
        let (port, nonce, period) = (address.port().to_be_bytes(), nonce.to_be_bytes(), period.to_be_bytes());
        // A message authentication code of the address and the nonce: the cloud checks a cookie without stored state.
        let mac = self.mac(b"cookie", &[&ip.octets(), &port, &nonce, &period]);
        let mut cookie = Cookie::default();
        cookie.copy_from_slice(&mac[..16]);
        cookie
    }

    fn mac(&self, purpose: &[u8], parts: &[&[u8]]) -> [u8; 32] {
        #[expect(clippy::expect_used, reason = "HMAC takes keys of any length")]
        let mut mac = Hmac::<Sha256>::new_from_slice(&self.0).expect("any length is a key");
        mac.update(purpose);
        parts.iter().for_each(|part| mac.update(part));
        mac.finalize().into_bytes().into()
    }
}

/// Returns the first 64 bits of a cookie or a message authentication code.
pub(crate) fn first_u64(bytes: &[u8]) -> u64 {
    bytes.first_chunk().map_or(0, |first| u64::from_be_bytes(*first))
}

/// Returns the number of the period at `now`. Each period is as long as [`COOKIE_LIFETIME`].
fn period(now: MonoTime) -> i64 {
    now.nanos().div_euclid(COOKIE_LIFETIME.nanos())
}

/// Outcome of a handshake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HandshakeOutcome {
    /// The connection exists; the other end has these terms.
    Opened { connection: u64, terms: Terms },
    /// The cloud accepts no more connections.
    Refused,
}

/// Error: even the smallest datagrams that are tried are too long for the path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the cloud answers short datagrams, but none of {bytes} bytes: a link on the path has a smaller MTU; correct its \
     MTU, or set datagram_bytes lower at one end"
)]
pub(crate) struct PathTooSmall {
    bytes: u16,
}

/// State of an edge that opens a connection.
#[derive(Debug)]
pub(crate) struct DialState {
    nonce: u64,
    /// Port to which the cloud is to answer; 0 means the source port of the packets.
    reply_port: u16,
    terms: Terms,
    prefix_bytes: usize,
    cookie: Option<Cookie>,
    is_second_cookie: bool,
    /// Number of unanswered packets of the current kind.
    attempts: u32,
    next_attempt: MonoTime,
    /// Length of datagrams that the path does not carry.
    too_long_bytes: Option<u16>,
}

impl DialState {
    /// Creates the state. `prefix_bytes` is the length of the prefix of each datagram.
    pub(crate) fn new(nonce: u64, reply_port: u16, terms: Terms, prefix_bytes: usize, now: MonoTime) -> Self {
        Self {
            nonce,
            reply_port,
            terms,
            prefix_bytes,
            cookie: None,
            is_second_cookie: false,
            attempts: 0,
            next_attempt: now,
            too_long_bytes: None,
        }
    }

    /// Handles a packet from the cloud's address.
    pub(crate) fn receive(&mut self, packet: &Packet<'_>, now: MonoTime) -> Option<HandshakeOutcome> {
        match *packet {
            // A cookie is used only while none is stored: a duplicated cookie would restart the count of attempts.
            Packet::Cookie { nonce, cookie } if nonce == self.nonce && self.cookie.is_none() => {
                (self.cookie, self.attempts, self.next_attempt) = (Some(cookie), 0, now);
                None
            }
            // No cloud states a limit below the minimum, so the limit was altered on the way. An altered limit must not
            // apply to the whole session.
            Packet::Opened { terms, .. } if terms.max_datagram_bytes < MIN_DATAGRAM_BYTES => None,
            Packet::Opened { nonce, connection, terms } if nonce == self.nonce => {
                let max_datagram_bytes = terms.max_datagram_bytes.min(self.terms.max_datagram_bytes);
                Some(HandshakeOutcome::Opened { connection, terms: Terms { max_datagram_bytes, ..terms } })
            }
            Packet::Reset { id, reason: ResetReason::Full } if id == self.nonce => {
                Some(HandshakeOutcome::Refused)
            }
            _ => None,
        }
    }

    /// Continues with shorter datagrams, because the path does not carry datagrams of the current length.
    ///
    /// # Errors
    /// If no shorter length remains to be tried.
    pub(crate) fn shorten(&mut self, now: MonoTime) -> Result<(), PathTooSmall> {
        let bytes = self.terms.max_datagram_bytes;
        if bytes <= SAFE_DATAGRAM_BYTES {
            return Err(PathTooSmall { bytes });
        }
        self.too_long_bytes = Some(bytes);
        (self.terms.max_datagram_bytes, self.attempts, self.next_attempt) = (SAFE_DATAGRAM_BYTES, 0, now);
        Ok(())
    }

    /// Returns the remark that the path carries only shorter datagrams, with advice. `None` if the path carries
    /// datagrams of the configured length.
    pub(crate) fn remark(&self) -> Option<String> {
        let bytes = self.too_long_bytes?;
        Some(format!(
            "the path carries no datagrams of the configured {bytes} bytes: continuing with {SAFE_DATAGRAM_BYTES} bytes; set datagram_bytes \
             lower, or the MTU of every link on the path higher"
        ))
    }

    /// Appends the next packet if the packet is due. Returns whether a packet was appended.
    ///
    /// # Errors
    /// If the cloud answers short packets, but no packet of the shortest length that is tried.
    pub(crate) fn fill(&mut self, out: &mut Vec<u8>, now: MonoTime) -> Result<bool, PathTooSmall> {
        if now < self.next_attempt {
            return Ok(false);
        }
        let is_large = self.terms.max_datagram_bytes > SAFE_DATAGRAM_BYTES;
        if self.cookie.is_some() && self.attempts >= if is_large { MAX_LARGE_ATTEMPTS } else { MAX_ATTEMPTS }
        {
            if is_large || self.is_second_cookie {
                self.shorten(now)?;
            } else {
                // The first cookie may be too old by now. If a second cookie arrives, short datagrams still pass, and
                // only the longer request gets no answer.
                (self.cookie, self.attempts, self.is_second_cookie) = (None, 0, true);
            }
        }
        let (nonce, reply_port) = (self.nonce, self.reply_port);
        match self.cookie {
            None => Packet::Hello { version: VERSION, nonce, reply_port }.write(Role::Edge, out),
            Some(cookie) => {
                let start = out.len();
                Packet::Open { nonce, cookie, reply_port, terms: self.terms }.write(Role::Edge, out);
                // The packet is as long as the longest datagram that will be sent, so that a path with a smaller MTU is
                // noticed here.
                // The limit of 64 bytes keeps the difference positive for any prefix.
                let padded_end =
                    start + usize::from(self.terms.max_datagram_bytes) - self.prefix_bytes.min(64);
                out.resize(out.len().max(padded_end), 0);
            }
        }
        self.next_attempt = now + Span::from_nanos(RETRY_INTERVAL.nanos() << self.attempts.min(3));
        self.attempts += 1;
        Ok(true)
    }

    /// Returns the time at which the next packet is due.
    pub(crate) const fn next_timer(&self) -> MonoTime {
        self.next_attempt
    }
}
