//! Runs as processes of their own, so that a crash is one run's.

use std::collections::VecDeque;
use std::os::unix::process::ExitStatusExt;
use std::process::{ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::exit::Exit;
use anyhow::Context;
use futures::StreamExt;
use futures::stream::FuturesUnordered;
use peernet_external::exec::with_arguments;
use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use serde::Deserialize;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::process::{ChildStdout, Command};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;

use super::ending::Ending;
use crate::foreground::Signals;
use crate::measure::{Order, Seen};

/// This program, even when its file was replaced in the meantime: all runs are measured by one version.
const PROGRAM: &str = "/proc/self/exe";
/// What processes told that may wait for the one who shows it. Later looks are left out; later lines hold the process up
/// that wants to say them, as a slow terminal would.
const TOLD: usize = 64;
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

/// What there is to show.
pub(super) enum News<'a> {
    /// How far each of the processes is, once it has told.
    Seen(&'a [Option<Seen>]),
    /// What users' own code printed in the process at this place, or its log.
    Line(usize, &'a str),
    /// How long the processes that were asked to end still may take.
    Ending(&'a str),
}

/// A line of a process's standard output.
#[derive(Deserialize)]
#[serde(untagged)]
enum Told {
    Seen(Seen),
    Line(String),
}

/// Executes orders, all at once, and shows what they tell. A signal to this program goes to all of them: at the
/// first they end early with their results, at the second they wait for nothing, at the third, or when they took too
/// long, they are killed with what they started.
pub(super) async fn execute(
    orders: &[Order],
    signals: &mut Signals,
    mut show: impl FnMut(News<'_>),
) -> Ended {
    let (to, mut from) = mpsc::channel(TOLD);
    let mut seen: Vec<Option<Seen>> = vec![None; orders.len()];
    let mut take = |index: usize, told: Told, show: &mut dyn FnMut(News<'_>)| match told {
        Told::Seen(now) => {
            seen[index] = Some(now);
            show(News::Seen(&seen));
        }
        Told::Line(line) => show(News::Line(index, &line)),
    };
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
    let mut ending = Ending::default();
    loop {
        tokio::select! {
            ended = waiting.next() => {
                let Some((index, exited)) = ended else { break };
                pids[index] = None;
                exits[index] = Some(exited);
            }
            Some((index, told)) = from.recv() => take(index, told, &mut show),
            () = signals.next() => {
                let (signal, told) = ending.wish(Instant::now());
                show(News::Ending(&told));
                send(&pids, signal);
            }
            () = ending.over() => {
                show(News::Ending("what did not end in time is killed"));
                send(&pids, ending.kill());
            }
        }
    }
    while let Ok((index, told)) = from.try_recv() {
        take(index, told, &mut show);
    }
    let gone = || Exited { code: None, reason: None };
    Ended {
        exits: exits.into_iter().map(|exit| exit.unwrap_or_else(gone)).collect(),
        interrupted: ending.is_wanted(),
    }
}

/// Signals the processes; a kill goes to all that they started as well.
fn send(processes: &[Option<Pid>], signal: Signal) {
    let each = if signal == Signal::KILL { kill_process_group } else { kill_process };
    for pid in processes.iter().flatten() {
        // One that has just ended needs none.
        let _ = each(*pid, signal);
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
    async fn start(index: usize, order: &Order, to: mpsc::Sender<(usize, Told)>) -> anyhow::Result<Self> {
        let order = with_arguments(|| serde_json::to_vec(order)).context("cannot write the order down")?;
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
            tokio::spawn(pass_on(index, output, to)),
            tokio::spawn(async move {
                let Some(errors) = errors else { return };
                let mut lines = BufReader::new(errors).lines();
                while let Ok(Some(line)) = lines.next_line().await {
                    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                    kept.push_back(line);
                    if kept.len() > LINES {
                        kept.pop_front();
                    }
                }
            }),
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

/// Hands on what the process at this place tells on its standard output.
async fn pass_on(index: usize, output: Option<ChildStdout>, to: mpsc::Sender<(usize, Told)>) {
    let Some(output) = output else { return };
    let mut lines = BufReader::new(output).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        // What is neither a look nor a text is nobody's: libraries print to standard output as well.
        match serde_json::from_str(&line) {
            Ok(look @ Told::Seen(_)) => drop(to.try_send((index, look))),
            Ok(text @ Told::Line(_)) => drop(to.send((index, text)).await),
            Err(_) => {}
        }
    }
}
