//! The process that runs `worker.py`, and the exchange of messages with it.

use std::io;
use std::os::fd::{AsRawFd, RawFd};

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_sample::Part;

use super::SOURCE;
use super::frame::{self, FrameError, MAX_VALUE_BYTES, PREFIX_BYTES, PartHead, Reply, Request};
use super::shared_memory::SharedMemory;
use crate::process::{Launch, Process, ProcessEnd, ProcessError};

/// Reply of the worker, with the bytes of the reply's parts.
pub(super) type ReplyWithBytes = (Reply, Vec<Bytes>);

/// Process of a Python object, and the memory that it shares with PEERNet.
#[derive(Debug)]
pub(super) struct Worker {
    process: Process,
    shared_memory: SharedMemory,
}

/// Failure after which the process cannot be used any more.
#[derive(Debug, thiserror::Error)]
pub(super) enum WorkerError {
    #[error(transparent)]
    Process(#[from] ProcessError),
    #[error("its process sent an invalid message: {0}")]
    InvalidMessage(#[from] FrameError),
    #[error("cannot share memory with its process: {0}")]
    Memory(io::Error),
}

impl Worker {
    /// Starts the process.
    pub(super) fn start(launch: &Launch, clock: &SharedClock) -> Result<Self, WorkerError> {
        let shared_memory = SharedMemory::new().map_err(WorkerError::Memory)?;
        let launch = Launch { inherited_file: Some(shared_memory.file()), ..launch.clone() };
        Ok(Self { process: Process::start(&launch, clock)?, shared_memory })
    }

    /// Returns the descriptor number under which the process finds the shared memory.
    pub(super) fn shared_memory_descriptor(&self) -> RawFd {
        self.shared_memory.file().as_raw_fd()
    }

    /// Sends the process its source and the settings of the object. Calls `report` with the elapsed time while the
    /// object is not created: first after `report_after`, then each time after twice the elapsed time.
    pub(super) fn create_object(
        &mut self,
        settings: &Request<'_>,
        deadline: MonoTime,
        (clock, report_after): (&SharedClock, Span),
        report: &mut dyn FnMut(Span),
    ) -> Result<ReplyWithBytes, WorkerError> {
        let header = encode_request(settings)?;
        self.process.write(&[SOURCE.as_bytes(), &header], deadline)?;
        let started_at = clock.mono();
        let mut elapsed = report_after;
        while started_at + elapsed < deadline {
            match self.process.wait_for_output(started_at + elapsed) {
                Ok(()) => break,
                Err(ProcessError::TimedOut) => report(elapsed),
                Err(error) => return Err(error.into()),
            }
            elapsed = elapsed + elapsed;
        }
        self.receive_reply(deadline)
    }

    /// Calls the object. `on_partial_answer` gets each partial answer and returns whether somebody still waits for
    /// the answer; `new_deadline` returns the end of a timeout that begins now.
    pub(super) fn call(
        &mut self,
        parts: &[Part],
        new_deadline: &dyn Fn() -> MonoTime,
        on_partial_answer: &mut dyn FnMut(Vec<Part>) -> bool,
    ) -> Result<ReplyWithBytes, WorkerError> {
        let positions = self.shared_memory.write_parts(parts).map_err(WorkerError::Memory)?;
        let heads = parts.iter().zip(&positions).map(|(part, at)| PartHead::new(part, *at)).collect();
        let header = encode_request(&Request::Call { parts: heads })?;
        let mut chunks: Vec<&[u8]> = vec![&header];
        let piped_parts = parts.iter().zip(&positions).filter(|(_, at)| at.is_none());
        chunks.extend(piped_parts.map(|(part, _)| &part.bytes[..]));
        self.process.write(&chunks, new_deadline())?;
        loop {
            let (reply, bytes) = self.receive_reply(new_deadline())?;
            let Reply::PartialAnswer { parts } = reply else {
                self.shared_memory.release_excess();
                return Ok((reply, bytes));
            };
            // The worker writes the next partial answer to the shared memory only after it has received `Proceed`. By
            // then, `receive_reply` has copied the current partial answer.
            let is_awaited = on_partial_answer(frame::join_parts(parts, bytes));
            let request = if is_awaited { Request::Proceed {} } else { Request::Cancel {} };
            self.process.write(&[&encode_request(&request)?], new_deadline())?;
        }
    }

    /// Calls `reset()` of the object.
    pub(super) fn reset(&mut self, deadline: MonoTime) -> Result<ReplyWithBytes, WorkerError> {
        self.send_and_receive(&Request::Reset {}, deadline)
    }

    /// Calls `advance(seconds)` of the object.
    pub(super) fn advance(&mut self, time: Span, deadline: MonoTime) -> Result<ReplyWithBytes, WorkerError> {
        self.send_and_receive(&Request::Advance { seconds: time.seconds() }, deadline)
    }

    /// Kills the process.
    pub(super) fn kill(self) -> ProcessEnd {
        self.process.kill()
    }

    /// Ends the process.
    pub(super) fn end(self, grace: Span) -> ProcessEnd {
        self.process.end(grace)
    }

    /// Sends a request without parts, and receives the reply.
    fn send_and_receive(
        &mut self,
        request: &Request<'_>,
        deadline: MonoTime,
    ) -> Result<ReplyWithBytes, WorkerError> {
        let header = encode_request(request)?;
        self.process.write(&[&header], deadline)?;
        self.receive_reply(deadline)
    }

    fn receive_reply(&mut self, deadline: MonoTime) -> Result<ReplyWithBytes, WorkerError> {
        let prefix = self.process.read_exact(PREFIX_BYTES, deadline)?;
        let length = frame::header_length(&prefix)?;
        let header = self.process.read_exact(length, deadline)?;
        let reply: Reply = serde_json::from_slice(&header).map_err(FrameError::from)?;
        let (Reply::Value { parts, .. } | Reply::PartialAnswer { parts }) = &reply else {
            return Ok((reply, Vec::new()));
        };
        let total = parts.iter().try_fold(0_u64, |sum, part| sum.checked_add(part.length));
        if total.is_none_or(|total| total > MAX_VALUE_BYTES) {
            return Err(FrameError::ValueLength.into());
        }
        let bytes = parts.iter().map(|part| self.read_part(part, deadline)).collect::<Result<_, _>>()?;
        Ok((reply, bytes))
    }

    /// Returns the bytes of a part, from the shared memory or from the pipe.
    fn read_part(&mut self, part: &PartHead, deadline: MonoTime) -> Result<Bytes, WorkerError> {
        // The length is at most `MAX_VALUE_BYTES`: `receive_reply` has checked the sum of all parts.
        let length = part.length as usize;
        let Some(at) = part.at else { return Ok(self.process.read_exact(length, deadline)?) };
        let bytes = self.shared_memory.read_part(at, length).map_err(WorkerError::Memory)?;
        bytes.ok_or_else(|| FrameError::Position { length, at }.into())
    }
}

fn encode_request(request: &Request<'_>) -> Result<Vec<u8>, WorkerError> {
    Ok(frame::encode(request).map_err(FrameError::from)?)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SystemClock};

    use super::super::{PythonConfig, Role, interpreter};
    use super::*;

    #[test]
    fn slow_start_is_reported_until_object_is_created() {
        let folder = tempfile::tempdir().expect("can be made");
        // The object is created after the second report.
        let source = "import os, time\nclass Slow:\n    def __init__(self):\n        while not os.path.exists('go'): \
                      time.sleep(0.01)\n    def sample(self): return 1\n";
        fs::write(folder.path().join("own.py"), source).expect("can be written");
        let config =
            PythonConfig { folder: Some(folder.path().to_owned()), ..PythonConfig::new("own::Slow") };
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let launch = interpreter::launch(&config, "sensor own::Slow".to_owned(), None).expect("has Python");
        let mut worker = Worker::start(&launch, &clock).expect("starts");
        let settings = Request::Start {
            module: "own",
            path: "Slow",
            role: Role::Sensor,
            pickle: false,
            images: config.images,
            shared_memory: worker.shared_memory_descriptor(),
        };
        let mut reports = Vec::new();
        let mut report = |elapsed: Span| {
            reports.push(elapsed);
            if reports.len() == 2 {
                fs::write(folder.path().join("go"), "").expect("can be written");
            }
        };
        let (report_after, deadline) = (Span::from_millis(200), clock.mono() + Span::from_millis(60_000));
        let result = worker.create_object(&settings, deadline, (&clock, report_after), &mut report);
        assert!(matches!(result, Ok((Reply::Ready(_), _))), "{result:?}");
        assert_eq!(reports[..2], [report_after, report_after + report_after]);
        worker.kill();
    }
}
