//! `peernet --server`: serves one model, and ends after a number of answers.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use crate::exit::{Exit, Failure};
use crate::output::print_to_stderr;
use anyhow::anyhow;
use peernet_agent::config::ServeConfig;
use peernet_networks::{Address, SessionSettings};

use super::devices::Devices;
use super::serve_observer::ServeObserver;
use super::{Arguments, model};
use crate::address::DEFAULT_PORT;
use crate::foreground::{AgentEnd, ReadyAgent, read_agent_tables};
use crate::measure::AgentStateDir;

/// Serves until the requested number of answers is given, no more requests will come, or the user presses Ctrl-C.
///
/// # Errors
/// When the model does not exist (exit code 66) or cannot run (exit code 69), or the port is in use (exit code 69).
/// Also when clients ended their runs without all iterations (exit code 75), or the user ended the server early (exit
/// code 130).
pub(super) fn run(arguments: &Arguments, devices: &Devices) -> Result<(), Failure> {
    let mut config = read_agent_tables(arguments.config.as_deref())?;
    let model = model::from_arguments(arguments, &config.onnxruntime)?;
    let name = model.name().clone();
    config.agent.name = Some(arguments.name.clone());
    let session =
        arguments.session(SessionSettings { ros2: devices.ros2.clone(), ..SessionSettings::default() });
    config.serve = Some(ServeConfig {
        listen: all_interfaces(&devices.server_address).into(),
        session,
        ..ServeConfig::default()
    });
    // Clients can use no model except the model of the command line.
    config.bank.folders.clear();
    config.models = vec![model];
    let state_dir = AgentStateDir::for_agent(&config.agent)?;
    state_dir.configure(&mut config)?;
    let ready = ReadyAgent::new(config)?;
    let mut observer = ServeObserver::new(name, arguments, ready.clock.clone());
    let result = ready.watch(&mut observer).map_err(|Failure { exit, error }| {
        let file = arguments.network_config.display();
        Failure::new(
            exit,
            error.context(format!("cannot serve at {}", describe_address(&devices.server_address, &file))),
        )
    })?;
    if observer.has_answers() || matches!(result.end, AgentEnd::Finished | AgentEnd::Interrupted) {
        print_to_stderr(observer.summary());
    }
    match result.end {
        AgentEnd::Finished => match observer.shortfall() {
            None => Ok(()),
            Some(text) => Err(Failure::new(Exit::Incomplete, anyhow!("{text}"))),
        },
        AgentEnd::Interrupted => {
            Err(Failure::new(Exit::Interrupted, anyhow!("ended before all answers were given")))
        }
        AgentEnd::OwnReason(error) => Err(model::failure(error)),
        AgentEnd::Failed(reason) => Err(Failure::new(Exit::Software, anyhow!("{reason}"))),
    }
}

/// Describes the part of the network configuration that sets the address.
fn describe_address(address: &Address, file: &impl std::fmt::Display) -> String {
    match address.listener_name() {
        // The parsed address does not show where its port comes from.
        None => format!(
            "port {} (the port of the server's address in {file}, otherwise start_port, otherwise {DEFAULT_PORT})",
            address.port()
        ),
        Some(_) => format!("{address}, as {file} and the environment variables say"),
    }
}

/// Returns the address of all interfaces of this machine, at the port of the network configuration: the configured
/// name of this device may be known to other devices only.
fn all_interfaces(address: &Address) -> Address {
    if address.listener_name().is_some() {
        // Host and port are not those of this device. They belong to a program that resolves the listener's name, such
        // as the ROS master.
        return address.clone();
    }
    let ip = match address.host().trim_matches(['[', ']']).parse() {
        Ok(IpAddr::V6(_)) => IpAddr::V6(Ipv6Addr::UNSPECIFIED),
        _ => IpAddr::V4(Ipv4Addr::UNSPECIFIED),
    };
    address.with_ip(ip, address.port())
}
