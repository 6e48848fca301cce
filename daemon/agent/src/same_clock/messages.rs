//! Messages of a clock socket: a query and its answer, each of fixed length. Numbers are big-endian.

use peernet_clock::RawTime;

/// Random value that identifies the query that an answer belongs to.
pub(super) type Nonce = [u8; 16];

const QUERY_MAGIC: [u8; 8] = *b"PEERNET?";
const ANSWER_MAGIC: [u8; 8] = *b"PEERNET!";

/// The edge's query for a reading of the cloud's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ClockQuery {
    pub(super) nonce: Nonce,
}

impl ClockQuery {
    pub(super) const BYTES: usize = 24;

    pub(super) fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        let (magic, nonce) = bytes.split_at_mut(QUERY_MAGIC.len());
        magic.copy_from_slice(&QUERY_MAGIC);
        nonce.copy_from_slice(&self.nonce);
        bytes
    }

    /// Parses a query; `None` for other bytes.
    pub(super) fn from_bytes(bytes: &[u8; Self::BYTES]) -> Option<Self> {
        let (magic, nonce) = bytes.split_first_chunk()?;
        (*magic == QUERY_MAGIC).then_some(Self { nonce: nonce.try_into().ok()? })
    }
}

/// The cloud's answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ClockAnswer {
    /// Nonce of the query.
    pub(super) nonce: Nonce,
    /// Id of the session whose hello named the socket.
    pub(super) session: [u8; 16],
    /// Inode of the time namespace of the cloud's process.
    pub(super) time_namespace: u64,
    /// `true` if the cloud's process reads the kernel's time.
    pub(super) shows_kernel_time: bool,
    /// Reading of the cloud's free-running clock after the query arrived.
    pub(super) raw: RawTime,
}

impl ClockAnswer {
    pub(super) const BYTES: usize = 57;

    pub(super) fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        let fields: [&[u8]; 6] = [
            &ANSWER_MAGIC,
            &self.nonce,
            &self.session,
            &self.time_namespace.to_be_bytes(),
            &[u8::from(self.shows_kernel_time)],
            &self.raw.nanos().to_be_bytes(),
        ];
        for (byte, field) in bytes.iter_mut().zip(fields.into_iter().flatten()) {
            *byte = *field;
        }
        bytes
    }

    /// Parses an answer; `None` for other bytes.
    pub(super) fn from_bytes(bytes: &[u8; Self::BYTES]) -> Option<Self> {
        let (magic, rest) = bytes.split_first_chunk()?;
        let (nonce, rest) = rest.split_first_chunk()?;
        let (session, rest) = rest.split_first_chunk()?;
        let (namespace, rest) = rest.split_first_chunk()?;
        let ([shows_kernel_time], raw) = rest.split_first_chunk()?;
        let is_answer = *magic == ANSWER_MAGIC && *shows_kernel_time <= 1;
        is_answer.then_some(Self {
            nonce: *nonce,
            session: *session,
            time_namespace: u64::from_be_bytes(*namespace),
            shows_kernel_time: *shows_kernel_time == 1,
            raw: RawTime::from_nanos(i64::from_be_bytes(raw.try_into().ok()?)),
        })
    }
}
