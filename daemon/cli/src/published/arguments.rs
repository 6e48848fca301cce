//! The published options, with the published defaults.

use std::num::{NonZeroU64, ParseIntError, TryFromIntError};
use std::path::PathBuf;

use peernet_logger::Slug;
use peernet_networks::{Address, NetworkKind};

use super::encoding::Encoding;
use super::sensor::SensorType;
use crate::network::network;
use crate::seconds::{SecondsError, seconds};

/// The published experiment: one device serves a model, the other senses and measures.
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
    /// Kind of network: zmq-tcp, zmq-udp or ros [default: the kind in the server's address; zmq-tcp if that is only a
    /// host name].
    #[arg(long, value_parser = network)]
    pub(super) network: Option<NetworkKind>,
    /// Network configuration, YAML: `devices:` name → host name or IP address, `server:` name of the device that serves,
    /// and optionally `start_port:` [default: 5551].
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
    /// A Python object with a method `sample()`, from a module of the current folder, as `module::object`; or a program,
    /// as `exec:COMMAND`.
    #[arg(long, value_name = "OBJECT")]
    pub(super) sensor_object: Option<String>,
    /// Pickle Python values that have no wire format in PEERNet, and unpickle received values. Unpickling runs code of
    /// the sender. Both ends need this option.
    #[arg(long)]
    pub(super) pickle: bool,
    /// Encoding of sent pictures: `pixels`, as in the published program; `file`, the unchanged file; `jpeg:QUALITY`, to
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

    /// Model that the server serves: `dummy` (takes 10 + 80 + 10 ms), `echo`, a name in the model bank, a path with a
    /// slash, a Python object with a method `infer(x)` as `module::object`, or a program as `exec:COMMAND`.
    #[arg(long, default_value = "dummy", value_name = "MODEL")]
    pub(super) model_name: String,
    /// Device of the model: `cpu`, `cuda`, `cuda:N`, `tensorrt:N`, `openvino:DEVICE`. Python objects and programs receive
    /// this value as it is [default: cuda:0 for a model of the bank].
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

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::Cli;

    fn read(line: &str) -> Arguments {
        let line = Cli::try_parse_from(line.split_whitespace()).expect("a published command line");
        line.published.expect("its options stand on the top level")
    }

    #[test]
    fn omitted_options_have_published_defaults() {
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
    fn subcommand_needs_no_published_option() {
        let line = Cli::try_parse_from(["peernet", "status"]).expect("a command");
        assert!(line.command.is_some() && line.published.is_none());
        assert!(Cli::try_parse_from(["peernet", "--client", "status"]).is_err());
    }
}
