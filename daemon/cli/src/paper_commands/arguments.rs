//! Options of the paper's commands, with the defaults of the paper's program.

use std::num::{NonZeroU64, ParseIntError, TryFromIntError};
use std::ops::RangeInclusive;
use std::path::PathBuf;

use peernet_logger::Slug;
use peernet_networks::{Address, NetworkKind, SessionSettings};

use super::encoding::Encoding;
use super::sensor::SensorType;
use crate::network::parse_network_kind;
use crate::seconds::{SecondsError, seconds};

/// Possible values of `--max-message-bytes`.
const MESSAGE_BYTES_RANGE: RangeInclusive<u64> =
    SessionSettings::MESSAGE_BYTES_RANGE.0..=SessionSettings::MESSAGE_BYTES_RANGE.1;

/// The paper's experiment: one device serves a model, the other senses and measures.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Published experiment")]
pub(crate) struct Arguments {
    /// Serve a model and end after --iterations answers; the default without --client.
    #[arg(long, conflicts_with = "client")]
    pub(super) server: bool,
    /// Sense, ask the server, and write the results.
    #[arg(long)]
    pub(super) client: bool,
    /// This device's name in the network configuration.
    #[arg(long, value_name = "DEVICE")]
    pub(super) name: Slug,
    /// Kind of network: zmq-tcp, zmq-udp or ros [default: the kind in the server's address; zmq-tcp if the address is
    /// only a host name].
    #[arg(long, value_parser = parse_network_kind)]
    pub(super) network: Option<NetworkKind>,
    /// Network configuration, YAML: `devices:` name → host name or IP address, `server:` name of the device that
    /// serves, and optionally `start_port:` [default: 5551].
    #[arg(long, value_name = "FILE")]
    pub(super) network_config: PathBuf,
    /// Number of iterations: for a client the rows of its results, for a server its answers.
    #[arg(long, value_name = "N", value_parser = iterations, allow_negative_numbers = true)]
    pub(super) iterations: NonZeroU64,

    /// Sensor of the client: `image`, `random string`, `external` (with --sensor-object) or `synthetic` (random bytes).
    #[arg(long, default_value = "image", value_name = "TYPE", value_parser = SensorType::read)]
    pub(super) sensor_type: SensorType,
    /// Picture, or folder of pictures, for the sensor `image`.
    #[arg(long, value_name = "PATH")]
    pub(super) dataset_loc: Option<PathBuf>,
    /// A Python object with a method `sample()`, from a module of the current folder, as `module::object`; or a
    /// program, as `exec:COMMAND`.
    #[arg(long, value_name = "OBJECT")]
    pub(super) sensor_object: Option<String>,
    /// Pickle Python values that have no wire format in PEERNet, and unpickle received values. Unpickling runs code of
    /// the sender. Both ends need this option.
    #[arg(long)]
    pub(super) pickle: bool,
    /// Encoding of sent pictures: `pixels`, as in the paper's program; `file`, the unchanged file; `jpeg:QUALITY`, to
    /// compress them again.
    #[arg(long, default_value = "pixels", value_name = "HOW", value_parser = Encoding::read)]
    pub(super) encoding: Encoding,
    /// Size of each sample: characters for `random string`, bytes for `synthetic`.
    #[arg(long, default_value = "1000", value_name = "N", allow_negative_numbers = true)]
    pub(super) text_size: usize,
    /// Folder for the client's results [default: results, or a new folder in it].
    #[arg(long, value_name = "DIR")]
    pub(super) result_loc: Option<PathBuf>,
    /// Replace results that the folder already has.
    #[arg(long)]
    pub(super) overwrite: bool,
    /// Draw the figures of the paper.
    #[arg(long)]
    pub(super) generate_plots: bool,
    /// Stream the client's run to the dashboard of this aggregator as well: tcp://host:5550.
    #[arg(long, value_name = "ADDRESS")]
    pub(super) aggregator: Option<Address>,
    /// Time to wait for an unreachable server, before the run and during it; seconds.
    #[arg(long, default_value = "90", value_name = "SECONDS", value_parser = patience, allow_negative_numbers = true)]
    pub(super) patience: f64,
    /// Client: longest wait for an answer. Server: longest time that a Python object or a program may take for one
    /// answer. Seconds [default: 75 for the client, 60 for an object, 10 for a program, so that the server reports a
    /// slow model before the client gives up].
    #[arg(long, value_name = "SECONDS", value_parser = timeout, allow_negative_numbers = true)]
    pub(super) timeout: Option<f64>,
    /// Largest message, in bytes; the smaller value of both ends applies. A picture sent as `pixels` has 3 bytes per
    /// pixel.
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u64).range(MESSAGE_BYTES_RANGE))]
    pub(super) max_message_bytes: Option<u64>,

    /// Model that the server serves: `dummy` (takes 10 + 80 + 10 ms), `echo`, a name in the model bank, a path with a
    /// slash, a Python object with a method `infer(x)` as `module::object`, or a program as `exec:COMMAND`.
    #[arg(long, default_value = "dummy", value_name = "MODEL")]
    pub(super) model_name: String,
    /// Device of the model: `cpu`, `cuda`, `cuda:N`, `tensorrt:N`, `openvino:DEVICE`. Python objects and programs
    /// receive this value as it is [default: cuda:0 for a model of the bank].
    #[arg(long)]
    pub(super) device: Option<String>,
    /// Folder of models that is searched before the others; may be given several times.
    #[arg(long, value_name = "DIR")]
    pub(super) models_dir: Vec<PathBuf>,

    /// An agent's configuration whose tables [clock], [probes], [clock_fault] and [onnxruntime] also apply here.
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// Do not show the progress.
    #[arg(long, short)]
    pub(super) quiet: bool,
}

/// Reason why a text is not a number of iterations.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum IterationsError {
    #[error("not a whole number")]
    NotANumber(#[source] ParseIntError),
    #[error("must be at least 1")]
    TooFew,
    #[error("must be at most {}", u64::MAX)]
    TooMany(#[source] TryFromIntError),
}

fn iterations(text: &str) -> Result<NonZeroU64, IterationsError> {
    // A wider type, so that negative and too large numbers get their own messages.
    let number = text.parse::<i128>().map_err(IterationsError::NotANumber)?;
    if number < 1 {
        return Err(IterationsError::TooFew);
    }
    let number = u64::try_from(number).map_err(IterationsError::TooMany)?;
    NonZeroU64::new(number).ok_or(IterationsError::TooFew)
}

fn patience(text: &str) -> Result<f64, SecondsError> {
    seconds(text, 0.0)
}

fn timeout(text: &str) -> Result<f64, SecondsError> {
    seconds(text, 0.001)
}

impl Arguments {
    /// Returns the settings of the session with the limit of `--max-message-bytes`, if it was given.
    pub(super) fn session(&self, settings: SessionSettings) -> SessionSettings {
        let max_message_bytes = self.max_message_bytes.unwrap_or(settings.max_message_bytes);
        SessionSettings { max_message_bytes, ..settings }
    }

    /// Returns `--timeout` in milliseconds.
    pub(super) fn timeout_ms(&self) -> Option<u64> {
        // The parser accepts a millisecond to a day.
        self.timeout.map(|seconds| (seconds * 1e3).round() as u64)
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::Cli;

    fn read(line: &str) -> Arguments {
        let line = Cli::try_parse_from(line.split_whitespace()).expect("a command line of the paper");
        line.paper.expect("its options are at the top level")
    }

    #[test]
    fn omitted_options_have_defaults_of_paper() {
        let read = read("peernet --name a --network-config b.yaml --iterations 7");
        assert!(!read.client && !read.generate_plots && !read.overwrite && !read.pickle && !read.quiet);
        assert_eq!((read.network, read.sensor_type), (None, SensorType::Image));
        assert_eq!((read.encoding, read.model_name.as_str()), (Encoding::Pixels, "dummy"));
        assert!(read.result_loc.is_none() && read.device.is_none() && read.dataset_loc.is_none());
    }

    #[test]
    fn commands_of_paper_are_parsed() {
        let server = read(
            "PEERNet --server --name cluster --network zmq-tcp --network-config net_config.yaml \
             --model-name efficientnet_v2_s --device cuda:6 --iterations 10005",
        );
        assert!(server.server && server.device.as_deref() == Some("cuda:6"));
        let client = read(
            "PEERNet --client --name jetson-orin --network zmq-tcp --network-config net_config.yaml \
             --dataset-loc sample-image.JPEG --iterations 10005 --result-loc results --generate-plots",
        );
        assert!(client.client && client.generate_plots && client.iterations.get() == 10_005);
    }

    #[test]
    fn limits_are_read_within_their_ranges() {
        let line = "peernet --client --name a --network-config b.yaml --iterations 7";
        let read = read(&format!("{line} --timeout 120.5 --max-message-bytes 200000000"));
        let session = read.session(SessionSettings::default());
        assert_eq!((read.timeout_ms(), session.max_message_bytes), (Some(120_500), 200_000_000));
        for wrong in ["--timeout 0", "--timeout -1", "--timeout 1e9", "--max-message-bytes 100"] {
            let words = format!("{line} {wrong}");
            assert!(Cli::try_parse_from(words.split_whitespace()).is_err(), "{wrong}");
        }
    }

    #[test]
    fn subcommand_needs_no_option_of_paper() {
        let line = Cli::try_parse_from(["peernet", "status"]).expect("a command");
        assert!(line.command.is_some() && line.paper.is_none());
        assert!(Cli::try_parse_from(["peernet", "--client", "status"]).is_err());
    }
}
