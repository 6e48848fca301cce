//! Where batches wait until they are acknowledged.

use std::collections::VecDeque;

use bytes::Bytes;

use super::StreamId;

/// Holds the numbered batches of one stream. Numbers are contiguous from 1, given by [`append`](Self::append), and
/// never used twice in a stream.
pub trait Spool {
    /// The stream that the numbers belong to.
    fn stream(&self) -> StreamId;

    /// Number of the newest batch that was ever appended; 0 before the first.
    fn newest(&self) -> u64;

    /// Number of the oldest batch it still holds; one more than the newest when it holds none.
    fn oldest(&self) -> u64;

    /// What it holds.
    fn usage(&self) -> Usage;

    /// Whether it can take that much more than what it holds.
    fn fits(&self, more: Usage) -> bool;

    /// Adds a batch and returns its number.
    ///
    /// # Errors
    /// When it could not be kept; it is then as it was.
    fn append(&mut self, batch: SpooledBatch) -> Result<u64, SpoolError>;

    /// The batch of that number, if it is held.
    ///
    /// # Errors
    /// When it could not be read.
    fn get(&self, number: u64) -> Result<Option<SpooledBatch>, SpoolError>;

    /// Deletes all batches up to and including that number and returns how many events were in them.
    ///
    /// # Errors
    /// When they could not be deleted; they are then still held.
    fn delete_through(&mut self, number: u64) -> Result<u64, SpoolError>;

    /// Gives the batches it holds new numbers from 1 in a new stream.
    ///
    /// # Errors
    /// When that could not be kept; it is then as it was.
    fn renew(&mut self, stream: StreamId) -> Result<(), SpoolError>;
}

/// Events and the bytes they take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// How many events.
    pub events: u64,
    /// Their bytes in wire form.
    pub bytes: u64,
}

impl std::ops::Add for Usage {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (events, bytes) =
            (self.events.saturating_add(other.events), self.bytes.saturating_add(other.bytes));
        Self { events, bytes }
    }
}

/// The events of one batch, encoded one after the other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpooledBatch {
    /// How many.
    pub events: u32,
    /// Their wire forms.
    pub body: Bytes,
}

/// A spool that did not do what was asked of it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the spool cannot {doing}: {reason}")]
pub struct SpoolError {
    /// What was tried, as a verb: `append batch 7`.
    pub doing: String,
    /// What went wrong.
    pub reason: String,
}

/// A spool in memory: lost with the process, and so is its stream, which is a new one each time.
#[derive(Debug)]
pub struct MemorySpool {
    stream: StreamId,
    batches: VecDeque<SpooledBatch>,
    oldest: u64,
    usage: Usage,
    most: Usage,
}

impl MemorySpool {
    /// An empty spool that takes that much.
    pub fn new(most: Usage) -> Self {
        let batches = VecDeque::new();
        Self { stream: StreamId::random(), batches, oldest: 1, usage: Usage::default(), most }
    }
}

impl Spool for MemorySpool {
    fn stream(&self) -> StreamId {
        self.stream
    }

    fn newest(&self) -> u64 {
        self.oldest + self.batches.len() as u64 - 1
    }

    fn oldest(&self) -> u64 {
        self.oldest
    }

    fn usage(&self) -> Usage {
        self.usage
    }

    fn fits(&self, more: Usage) -> bool {
        let wanted = self.usage + more;
        wanted.events <= self.most.events && wanted.bytes <= self.most.bytes
    }

    fn append(&mut self, batch: SpooledBatch) -> Result<u64, SpoolError> {
        let more = Usage { events: u64::from(batch.events), bytes: batch.body.len() as u64 };
        if !self.fits(more) {
            let doing = format!("append batch {}", self.newest() + 1);
            return Err(SpoolError { doing, reason: "it is full".into() });
        }
        self.usage = self.usage + more;
        self.batches.push_back(batch);
        Ok(self.newest())
    }

    fn get(&self, number: u64) -> Result<Option<SpooledBatch>, SpoolError> {
        let index = number.checked_sub(self.oldest).and_then(|index| usize::try_from(index).ok());
        Ok(index.and_then(|index| self.batches.get(index)).cloned())
    }

    fn delete_through(&mut self, number: u64) -> Result<u64, SpoolError> {
        let mut events = 0;
        while self.oldest <= number
            && let Some(batch) = self.batches.pop_front()
        {
            self.oldest += 1;
            events += u64::from(batch.events);
            self.usage.bytes -= batch.body.len() as u64;
        }
        self.usage.events -= events;
        Ok(events)
    }

    fn renew(&mut self, stream: StreamId) -> Result<(), SpoolError> {
        (self.stream, self.oldest) = (stream, 1);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn batch(events: u32) -> SpooledBatch {
        SpooledBatch { events, body: vec![0; events as usize * 10].into() }
    }

    #[test]
    fn numbers_go_on_after_everything_was_deleted() {
        let mut spool = MemorySpool::new(Usage { events: 10, bytes: 1000 });
        assert_eq!((spool.oldest(), spool.newest()), (1, 0));
        assert_eq!((spool.append(batch(4)), spool.append(batch(5))), (Ok(1), Ok(2)));
        assert_eq!(spool.delete_through(9), Ok(9));
        assert_eq!((spool.oldest(), spool.newest(), spool.usage()), (3, 2, Usage::default()));
        assert_eq!(spool.append(batch(1)), Ok(3));
        assert_eq!(spool.get(3), Ok(Some(batch(1))));
        assert_eq!(spool.get(2), Ok(None));
    }

    #[test]
    fn it_takes_no_more_than_it_may() {
        let mut spool = MemorySpool::new(Usage { events: 10, bytes: 70 });
        assert_eq!(spool.append(batch(7)), Ok(1));
        let error = spool.append(batch(1)).expect_err("no bytes left");
        assert_eq!(error.to_string(), "the spool cannot append batch 2: it is full");
    }

    #[test]
    fn a_renewed_stream_starts_at_one_with_what_was_held() {
        let mut spool = MemorySpool::new(Usage { events: 10, bytes: 1000 });
        (1..=3).for_each(|n| assert_eq!(spool.append(batch(n)), Ok(u64::from(n))));
        spool.delete_through(1).expect("memory");
        let stream = StreamId::random();
        spool.renew(stream).expect("memory");
        assert_eq!((spool.stream(), spool.oldest(), spool.newest()), (stream, 1, 2));
        assert_eq!(spool.get(1), Ok(Some(batch(2))));
    }
}
