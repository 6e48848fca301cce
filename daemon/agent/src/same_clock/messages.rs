//! What goes over a clock socket: a question and its answer, each of one length. Numbers are big-endian.

use peernet_clock::RawTime;

/// What makes an answer the one to a question.
pub(super) type Nonce = [u8; 16];

const ASKS: [u8; 8] = *b"PEERNET?";
const ANSWERS: [u8; 8] = *b"PEERNET!";

/// The edge's question: what does the clock show now?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Question {
    pub(super) nonce: Nonce,
}

impl Question {
    pub(super) const BYTES: usize = 24;

    pub(super) fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        let (kind, nonce) = bytes.split_at_mut(ASKS.len());
        kind.copy_from_slice(&ASKS);
        nonce.copy_from_slice(&self.nonce);
        bytes
    }

    /// `None` for bytes that are no question.
    pub(super) fn from_bytes(bytes: &[u8; Self::BYTES]) -> Option<Self> {
        let (kind, nonce) = bytes.split_first_chunk()?;
        (*kind == ASKS).then_some(Self { nonce: nonce.try_into().ok()? })
    }
}

/// The cloud's answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Answer {
    /// That of the question.
    pub(super) nonce: Nonce,
    /// The session for which the socket was named.
    pub(super) session: [u8; 16],
    /// Inode of the time namespace of the cloud's process.
    pub(super) time_namespace: u64,
    /// Whether the cloud's process is shown the kernel's time.
    pub(super) shows_kernel_time: bool,
    /// What its free-running clock showed after the question came.
    pub(super) raw: RawTime,
}

impl Answer {
    pub(super) const BYTES: usize = 57;

    pub(super) fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        let fields: [&[u8]; 6] = [
            &ANSWERS,
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

    /// `None` for bytes that are no answer.
    pub(super) fn from_bytes(bytes: &[u8; Self::BYTES]) -> Option<Self> {
        let (kind, rest) = bytes.split_first_chunk()?;
        let (nonce, rest) = rest.split_first_chunk()?;
        let (session, rest) = rest.split_first_chunk()?;
        let (namespace, rest) = rest.split_first_chunk()?;
        let ([shows_kernel_time], raw) = rest.split_first_chunk()?;
        let is_answer = *kind == ANSWERS && *shows_kernel_time <= 1;
        is_answer.then_some(Self {
            nonce: *nonce,
            session: *session,
            time_namespace: u64::from_be_bytes(*namespace),
            shows_kernel_time: *shows_kernel_time == 1,
            raw: RawTime::from_nanos(i64::from_be_bytes(raw.try_into().ok()?)),
        })
    }
}
