//! The model that `peernet --server` serves.

use std::num::NonZeroU64;

use crate::clock;
use crate::exit::{Exit, Failure};
use anyhow::anyhow;
use peernet_clock::{ClockIdentity, SharedClock};
use peernet_inference::bank::ModelFolders;
use peernet_inference::{Bank, CommonSettings, LoadError, ModelConfig, OnnxRuntimeConfig};
use peernet_logger::Slug;

use super::Arguments;

/// Device of a model of the bank if `--device` is not given, as in the paper's program.
const DEFAULT_DEVICE: &str = "cuda:0";

/// Returns the model's configuration after checking its files and its device.
///
/// # Errors
/// When the model does not exist (exit code 66), the name of the object or the device is invalid
/// (exit code 64), or the model cannot run on this device (exit code 69).
pub(super) fn from_arguments(
    arguments: &Arguments,
    runtime: &OnnxRuntimeConfig,
) -> Result<ModelConfig, Failure> {
    let config = configuration(arguments)?;
    let clock =
        clock::system(ClockIdentity::SYSTEM).map_err(|error| Failure::new(Exit::Unavailable, error))?;
    match check(&config, runtime, clock) {
        None => Ok(config),
        Some(error) => Err(failure(error)),
    }
}

fn configuration(arguments: &Arguments) -> Result<ModelConfig, Failure> {
    let (model_name, device_option) = (arguments.model_name.as_str(), arguments.device.as_deref());
    if model_name == "dummy" {
        return Ok(ModelConfig::sleep(slug(model_name)));
    }
    if model_name == "echo" {
        return Ok(ModelConfig::echo(slug(model_name)));
    }
    let common_settings = |name| {
        let common = CommonSettings::new(slug(name));
        match device_option {
            Some(device) => CommonSettings { device: device.to_owned(), ..common },
            None => common,
        }
    };
    let timeout_ms = arguments.timeout_ms().and_then(NonZeroU64::new);
    Ok(match super::exec_command(model_name)? {
        Some(command) => ModelConfig::program(common_settings(program_of(command)), command, timeout_ms),
        None if model_name.contains("::") => {
            ModelConfig::python_object(common_settings(model_name), model_name, arguments.pickle, timeout_ms)
        }
        None => {
            let model = ModelFolders::search(&arguments.models_dir).find(model_name);
            let model = model.map_err(|error| Failure::new(Exit::NoInput, error))?;
            model.configuration(bank_device(device_option.unwrap_or(DEFAULT_DEVICE)))
        }
    })
}

/// Returns the name that the bank uses for a device.
fn bank_device(device: &str) -> &str {
    match device {
        "cuda" => "cuda:0",
        "tensorrt" => "tensorrt:0",
        other => other,
    }
}

fn check(config: &ModelConfig, runtime: &OnnxRuntimeConfig, clock: SharedClock) -> Option<LoadError> {
    let bank = Bank::new(vec![config.clone()], runtime.clone(), clock);
    bank.check().into_iter().next().map(|(_, error)| error)
}

/// Converts the error into a failure. If a device other than `cpu` cannot be used, the text names
/// `--device cpu`, because many hosts do not have `cuda:0`, the default device of the paper's
/// program.
pub(super) fn failure(error: LoadError) -> Failure {
    let exit = match &error {
        error if error.is_missing() => Exit::NoInput,
        error if error.is_invalid_object_name() => Exit::Usage,
        LoadError::InvalidDevice(_) | LoadError::AboveLimit { .. } => Exit::Usage,
        _ => Exit::Unavailable,
    };
    if let LoadError::NoProvider { device, .. } | LoadError::Session { device, .. } = &error
        && device != "cpu"
    {
        return Failure::new(exit, anyhow!("{error}; --device cpu computes on the processor"));
    }
    Failure::new(exit, error)
}

/// Returns the program of a command. The arguments of the command may be secret and must not be part of a name.
fn program_of(command: &str) -> &str {
    let program = command.split_ascii_whitespace().next().unwrap_or(command);
    // A shell runs a command that begins with an assignment, such as `TOKEN=x ./infer`.
    if program.contains('=') { "sh" } else { program }
}

/// Converts a text to a name for results and pages: `my_model::Net` becomes `my_model-Net`.
fn slug(text: &str) -> Slug {
    let mut name = String::new();
    for char in text.chars() {
        let char = if char.is_ascii_alphanumeric() || "._-".contains(char) { char } else { '-' };
        if char != '-' || !name.ends_with('-') {
            name.push(char);
        }
    }
    let name = name.trim_matches(|char: char| !char.is_ascii_alphanumeric());
    let name: String = name.chars().take(64).collect();
    name.parse().unwrap_or_else(|_| "model".parse().expect("is a name"))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::Cli;

    #[test]
    fn custom_code_receives_device_as_it_is() {
        let line = "peernet --server --name a --network-config b.yaml --iterations 7 --model-name m::N --device cuda";
        let line = Cli::try_parse_from(line.split_whitespace()).expect("a command line of the paper");
        let arguments = line.paper.expect("its options are at the top level");
        assert_eq!(configuration(&arguments).expect("a model").device(), "cuda");
    }

    #[test]
    fn object_and_command_names_become_model_names() {
        let text = ["my_model::Net", program_of("./infer --token x"), "::", &"x".repeat(80)]
            .map(slug)
            .map(|name| name.to_string());
        assert_eq!(text, ["my_model-Net", "infer", "model", &"x".repeat(64)]);
        assert_eq!(program_of("TOKEN=x ./infer"), "sh");
    }

    #[test]
    fn device_without_number_means_number_0() {
        assert_eq!(
            ["cpu", "cuda", "cuda:6", "tensorrt"].map(bank_device),
            ["cpu", "cuda:0", "cuda:6", "tensorrt:0"]
        );
    }
}
