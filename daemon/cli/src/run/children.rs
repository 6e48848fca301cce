//! Separate processes for the runs, so that a crash affects one run only.

use std::collections::{BTreeSet, VecDeque};
use std::process::Stdio;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::exit::Exit;
use anyhow::Context;
use futures::StreamExt;
use futures::stream::FuturesUnordered;
use peernet_external::exec::with_arguments;
use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use serde::Deserialize;
use tokio::io::{AsyncBufRead, AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::process::{ChildStdin, ChildStdout, Command};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;

use super::end_requests::EndRequests;
use super::exit_reason::exit_reason;
use super::silence_detector::SilenceDetector;
use crate::foreground::Signals;
use crate::measure::{MEASUREMENT_ENDED, ProgressReport, RunRequest};

/// Path of this program. The path leads to the same program even if the file is replaced in the meantime, so that one
/// version measures all runs.
const PROGRAM: &str = "/proc/self/exe";
/// Capacity of the channel of output from the processes. If the channel is full, progress is dropped, and a line of
/// text blocks its process, as a slow terminal would.
const OUTPUT_CAPACITY: usize = 64;
/// Number of lines at the end of a process's error output that are kept.
const LAST_LINES: usize = 20;
/// Longest wait for the rest of a process's output after the end of the process: programs that the process started may
/// hold the pipe open.
const OUTPUT_TIMEOUT: Duration = Duration::from_secs(2);

/// Result of several concurrent processes.
pub(super) struct ProcessResults {
    /// Results, one for each request.
    pub(super) results: Vec<ProcessResult>,
    /// `true` if the user requested the end.
    pub(super) interrupted: bool,
}

/// Result of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ProcessResult {
    /// Exit code; `None` if a signal ended the process or the process did not start.
    pub(super) code: Option<i32>,
    /// Message at the end of the error output in one line, or the signal that ended the process.
    pub(super) reason: Option<String>,
}

impl ProcessResult {
    pub(super) fn is_successful(&self) -> bool {
        self.code == Some(i32::from(Exit::Ok as u8))
    }
}

/// Output to be shown.
pub(super) enum ChildEvent<'a> {
    /// Progress of each process, once it has reported.
    ProgressReport(&'a [Option<ProgressReport>]),
    /// Output of custom code in the process of this index, or a line of the log of this process.
    Line(usize, &'a str),
    /// Announcement of how long the processes may still take to end, or that they are killed.
    EndAnnouncement(&'a str),
}

/// A line of a process's standard output.
#[derive(Deserialize)]
#[serde(untagged)]
enum ChildOutput {
    ProgressReport(Box<ProgressReport>),
    Line(String),
    /// The line [`MEASUREMENT_ENDED`]. `pass_on` compares the text of the line, so serde skips this variant.
    #[serde(skip)]
    MeasurementEnded,
}

/// Measures the requested runs concurrently, each in its own process, and shows the output of the processes. No process
/// writes results or draws figures before all processes have ended their measurement. Otherwise the processes that
/// still measure would measure a busy machine.
///
/// A signal to this program goes to all processes. After the first signal, the processes end early and write their
/// results. After the second signal, they do not wait for work in progress. After the third signal, or after a time
/// limit, they and the programs that they started are killed.
pub(super) async fn execute(
    requests: &[RunRequest],
    signals: &mut Signals,
    mut show: impl FnMut(ChildEvent<'_>),
) -> ProcessResults {
    let (sender, mut receiver) = mpsc::channel(OUTPUT_CAPACITY);
    let mut silence_detector = SilenceDetector::new(requests.len());
    let mut reports: Vec<Option<ProgressReport>> = vec![None; requests.len()];
    let mut handle = |index: usize, output: ChildOutput, show: &mut dyn FnMut(ChildEvent<'_>)| match output {
        ChildOutput::ProgressReport(report) => {
            reports[index] = Some(*report);
            show(ChildEvent::ProgressReport(&reports));
        }
        ChildOutput::Line(line) => show(ChildEvent::Line(index, &line)),
        ChildOutput::MeasurementEnded => {}
    };
    let mut results: Vec<Option<ProcessResult>> = vec![None; requests.len()];
    let mut pids: Vec<Option<Pid>> = Vec::new();
    let mut measuring = MeasuringProcesses::default();
    let mut process_ends = FuturesUnordered::new();
    for (index, request) in requests.iter().enumerate() {
        match Child::start(index, request, sender.clone()).await {
            Ok(mut child) => {
                pids.push(child.pid);
                measuring.inputs.push(child.input.take());
                measuring.indexes.insert(index);
                process_ends.push(async move { (index, child.wait_for_end().await) });
            }
            Err(error) => {
                pids.push(None);
                results[index] = Some(ProcessResult { code: None, reason: Some(format!("{error:#}")) });
            }
        }
    }
    let mut end_requests = EndRequests::default();
    loop {
        tokio::select! {
            ended = process_ends.next() => {
                let Some((index, result)) = ended else { break };
                pids[index] = None;
                results[index] = Some(result);
                measuring.remove(index);
            }
            Some((index, output)) = receiver.recv() => {
                match output {
                    ChildOutput::MeasurementEnded => measuring.remove(index),
                    ChildOutput::ProgressReport(_) => silence_detector.record_report(index),
                    ChildOutput::Line(_) => {}
                }
                handle(index, output, &mut show);
            }
            _ = signals.next() => {
                // Processes that have ended their measurement write their results now, even if another process hangs.
                measuring.inputs.clear();
                let (signal, message) = end_requests.request(Instant::now());
                show(ChildEvent::EndAnnouncement(&message));
                send(&pids, signal);
            }
            () = silence_detector.wait() => {
                for index in silence_detector.newly_silent(Instant::now(), &measuring.indexes) {
                    show(ChildEvent::Line(index, &SilenceDetector::message()));
                }
            }
            () = end_requests.wait_for_deadline() => {
                show(ChildEvent::EndAnnouncement("killing the processes that did not end in time"));
                send(&pids, end_requests.take_kill_signal());
            }
        }
    }
    while let Ok((index, output)) = receiver.try_recv() {
        handle(index, output, &mut show);
    }
    let without_result = || ProcessResult { code: None, reason: None };
    ProcessResults {
        results: results.into_iter().map(|result| result.unwrap_or_else(without_result)).collect(),
        interrupted: end_requests.is_requested(),
    }
}

/// The processes that still measure, and the standard inputs of all processes. A process waits for the end of its input
/// before it writes results.
#[derive(Default)]
struct MeasuringProcesses {
    indexes: BTreeSet<usize>,
    inputs: Vec<Option<ChildStdin>>,
}

impl MeasuringProcesses {
    /// Removes a process that no longer measures. Closes all inputs if it was the last one.
    fn remove(&mut self, index: usize) {
        self.indexes.remove(&index);
        if self.indexes.is_empty() {
            self.inputs.clear();
        }
    }
}

/// Sends a signal to the processes. SIGKILL also goes to all processes that they started.
fn send(processes: &[Option<Pid>], signal: Signal) {
    let send_signal = if signal == Signal::KILL { kill_process_group } else { kill_process };
    for pid in processes.iter().flatten() {
        // Sending fails for a process that has just ended.
        let _ = send_signal(*pid, signal);
    }
}

/// A running process.
struct Child {
    process: tokio::process::Child,
    pid: Option<Pid>,
    input: Option<ChildStdin>,
    error_lines: Arc<Mutex<VecDeque<String>>>,
    readers: [JoinHandle<()>; 2],
}

impl Child {
    async fn start(
        index: usize,
        request: &RunRequest,
        sender: mpsc::Sender<(usize, ChildOutput)>,
    ) -> anyhow::Result<Self> {
        // Without `with_arguments`, programs in the request would lose their arguments.
        let mut request = with_arguments(|| serde_json::to_vec(request))
            .context("cannot write the description of the measurement")?;
        // The process reads one line. The end of its input later means that no process measures any more.
        request.push(b'\n');
        let mut process = Command::new(PROGRAM)
            // One program is daemon and command line. The program acts as the command line if it is started under this
            // name.
            .arg0(crate::NAMES[0])
            .args(["measure", "--order", "-"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // The process has its own process group, so that Ctrl-C on the terminal reaches this program only. This
            // program passes the signal on once.
            .process_group(0)
            // If this program gives up a process, the process must not go on measuring.
            .kill_on_drop(true)
            .spawn()
            .context("cannot start the process of the run")?;
        let (mut input, output, errors) =
            (process.stdin.take(), process.stdout.take(), process.stderr.take());
        if let Some(input) = &mut input {
            // A process that ends before it has read its request reports the reason.
            let _ = input.write_all(&request).await;
        }
        let error_lines = Arc::new(Mutex::new(VecDeque::new()));
        let last_lines = Arc::clone(&error_lines);
        let readers = [
            tokio::spawn(pass_on(index, output, sender)),
            tokio::spawn(async move {
                let Some(errors) = errors else { return };
                let mut errors = BufReader::new(errors);
                while let Some(line) = next_line(&mut errors).await {
                    let mut last_lines = last_lines.lock().unwrap_or_else(PoisonError::into_inner);
                    last_lines.push_back(line);
                    if last_lines.len() > LAST_LINES {
                        last_lines.pop_front();
                    }
                }
            }),
        ];
        let pid = process.id().and_then(|pid| Pid::from_raw(i32::try_from(pid).ok()?));
        Ok(Self { process, pid, input, error_lines, readers })
    }

    async fn wait_for_end(mut self) -> ProcessResult {
        let status = self.process.wait().await;
        for reader in self.readers {
            // Output that arrived until now is kept.
            let _ = tokio::time::timeout(OUTPUT_TIMEOUT, reader).await;
        }
        let error_lines = self.error_lines.lock().unwrap_or_else(PoisonError::into_inner);
        match status {
            Ok(status) => ProcessResult { code: status.code(), reason: exit_reason(status, &error_lines) },
            Err(error) => {
                ProcessResult { code: None, reason: Some(format!("cannot wait for the process: {error}")) }
            }
        }
    }
}

/// Passes on the standard output of the process of this index.
async fn pass_on(index: usize, output: Option<ChildStdout>, sender: mpsc::Sender<(usize, ChildOutput)>) {
    let Some(output) = output else { return };
    let mut output = BufReader::new(output);
    while let Some(line) = next_line(&mut output).await {
        if line == MEASUREMENT_ENDED {
            drop(sender.send((index, ChildOutput::MeasurementEnded)).await);
            continue;
        }
        // Other lines are ignored: libraries print to standard output as well.
        match serde_json::from_str(&line) {
            Ok(report @ ChildOutput::ProgressReport(_)) => drop(sender.try_send((index, report))),
            Ok(text @ ChildOutput::Line(_)) => drop(sender.send((index, text)).await),
            Ok(ChildOutput::MeasurementEnded) | Err(_) => {}
        }
    }
}

/// Reads the next line, without its line ending; `None` after the last line or an error. Bytes that
/// are not UTF-8 are replaced: libraries may print such bytes, and the lines after them are needed.
async fn next_line(output: &mut (impl AsyncBufRead + Unpin)) -> Option<String> {
    let mut line = Vec::new();
    match output.read_until(b'\n', &mut line).await {
        Ok(0) | Err(_) => None,
        Ok(_) => Some(String::from_utf8_lossy(&line).trim_end_matches(['\r', '\n']).to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn lines_after_invalid_utf8_are_read() {
        let mut output = &b"caf\xe9\r\n\n{\"measurement-ended\":true}\nend"[..];
        let mut lines = Vec::new();
        while let Some(line) = next_line(&mut output).await {
            lines.push(line);
        }
        assert_eq!(lines, ["caf\u{fffd}", "", MEASUREMENT_ENDED, "end"]);
    }
}
