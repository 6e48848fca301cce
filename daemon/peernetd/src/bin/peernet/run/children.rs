//! Runs as processes of their own, so that a crash is one run's.

use std::collections::VecDeque;
use std::os::unix::process::ExitStatusExt;
use std::process::{ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context;
use futures::StreamExt;
use futures::stream::FuturesUnordered;
use peernetd::exit::Exit;
use rustix::process::{Pid, Signal, kill_process};
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncWriteExt, BufReader};
use tokio::process::Command;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use crate::foreground::Signals;
use crate::measure::{Order, Seen};

/// This program, even when its file was replaced in the meantime: all runs are measured by one version.
const PROGRAM: &str = "/proc/self/exe";
/// Looks that may wait for the one who shows them; later ones are left out.
const LOOKS: usize = 64;
/// Last lines of a process that are kept.
const LINES: usize = 20;
/// How long the rest of what a process said is waited for after its end: its own children may hold the pipe open.
const REST: Duration = Duration::from_secs(2);

/// How several processes at once ended.
pub(super) struct Ended {
    /// One for each order.
    pub(super) exits: Vec<Exited>,
    /// Whether the user wanted the end.
    pub(super) interrupted: bool,
}

/// How a process ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Exited {
    /// Its exit code; `None` when a signal ended it or it never was.
    pub(super) code: Option<i32>,
    /// The last it said, or what ended it.
    pub(super) reason: Option<String>,
}

impl Exited {
    pub(super) fn is_well(&self) -> bool {
        self.code == Some(i32::from(Exit::Ok as u8))
    }
}

/// Executes orders, all at once, and shows what is seen of each. A signal to this program goes to all of them: at the
/// first they end early with their results, at the second they wait for nothing, at the third they are killed.
pub(super) async fn execute(
    orders: &[Order],
    signals: &mut Signals,
    mut look: impl FnMut(&[Option<Seen>]),
) -> Ended {
    let (to, mut from) = mpsc::channel(LOOKS);
    let mut seen: Vec<Option<Seen>> = vec![None; orders.len()];
    let mut exits: Vec<Option<Exited>> = vec![None; orders.len()];
    let mut pids: Vec<Option<Pid>> = Vec::new();
    let mut waiting = FuturesUnordered::new();
    for (index, order) in orders.iter().enumerate() {
        match Child::start(index, order, to.clone()).await {
            Ok(child) => {
                pids.push(child.pid);
                waiting.push(async move { (index, child.ended().await) });
            }
            Err(error) => {
                pids.push(None);
                exits[index] = Some(Exited { code: None, reason: Some(format!("{error:#}")) });
            }
        }
    }
    let mut signalled = 0_u32;
    loop {
        tokio::select! {
            ended = waiting.next() => {
                let Some((index, exited)) = ended else { break };
                pids[index] = None;
                exits[index] = Some(exited);
            }
            Some((index, now)) = from.recv() => {
                seen[index] = Some(now);
                look(&seen);
            }
            () = signals.next() => {
                signalled += 1;
                let signal = if signalled > 2 { Signal::KILL } else { Signal::INT };
                for pid in pids.iter().flatten() {
                    // One that has just ended needs none.
                    let _ = kill_process(*pid, signal);
                }
            }
        }
    }
    let gone = || Exited { code: None, reason: None };
    Ended {
        exits: exits.into_iter().map(|exit| exit.unwrap_or_else(gone)).collect(),
        interrupted: signalled > 0,
    }
}

/// A running process.
struct Child {
    process: tokio::process::Child,
    pid: Option<Pid>,
    said: Arc<Mutex<VecDeque<String>>>,
    readers: [JoinHandle<()>; 2],
}

impl Child {
    async fn start(index: usize, order: &Order, to: mpsc::Sender<(usize, Seen)>) -> anyhow::Result<Self> {
        let order = serde_json::to_vec(order).context("cannot write the order down")?;
        let mut process = Command::new(PROGRAM)
            .args(["measure", "--order", "-"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A terminal's Ctrl-C is for this program, which passes it on once.
            .process_group(0)
            .kill_on_drop(true)
            .spawn()
            .context("cannot start the process of the run")?;
        let (input, output, errors) = (process.stdin.take(), process.stdout.take(), process.stderr.take());
        if let Some(mut input) = input {
            // A process that ends before it has read its order says why.
            let _ = input.write_all(&order).await;
        }
        let said = Arc::new(Mutex::new(VecDeque::new()));
        let kept = Arc::clone(&said);
        let readers = [
            tokio::spawn(lines(output, move |line| {
                // Looks that nobody has time for are left out, and so is what is no look.
                if let Ok(seen) = serde_json::from_str(&line) {
                    let _ = to.try_send((index, seen));
                }
            })),
            tokio::spawn(lines(errors, move |line| {
                let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                kept.push_back(line);
                if kept.len() > LINES {
                    kept.pop_front();
                }
            })),
        ];
        let pid = process.id().and_then(|pid| Pid::from_raw(i32::try_from(pid).ok()?));
        Ok(Self { process, pid, said, readers })
    }

    async fn ended(mut self) -> Exited {
        let status = self.process.wait().await;
        for reader in self.readers {
            // What came until now is kept.
            let _ = tokio::time::timeout(REST, reader).await;
        }
        let said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        let last = said.iter().rev().find(|line| !line.trim().is_empty()).cloned();
        match status {
            Ok(status) => Exited { code: status.code(), reason: reason(status, last) },
            Err(error) => {
                Exited { code: None, reason: Some(format!("cannot wait for the process: {error}")) }
            }
        }
    }
}

fn reason(status: ExitStatus, last: Option<String>) -> Option<String> {
    match status.signal() {
        Some(signal) => {
            let said = last.map_or_else(String::new, |last| format!("; the last it said: {last}"));
            Some(format!("the process was ended by signal {signal}{said}"))
        }
        None => last,
    }
}

async fn lines(pipe: Option<impl AsyncRead + Unpin>, mut take: impl FnMut(String)) {
    let Some(pipe) = pipe else { return };
    let mut lines = BufReader::new(pipe).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        take(line);
    }
}
