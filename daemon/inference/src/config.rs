//! `[[model]]` and `[onnxruntime]` in the configuration.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use peernet_external::hide_values;
use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use crate::defaults::{cpu, one, sixteen};
use crate::{ExecModelConfig, LoadError, PythonModelConfig};

/// Most threads that compute samples of one model.
const MAX_WORKERS: usize = 256;
/// Most samples that may wait for one model.
const MAX_QUEUE: usize = 65_536;
/// Most threads within or across the operators of a model.
const MAX_THREADS: usize = 1024;
/// Largest fixed answer: 1 GiB.
const MAX_ANSWER_BYTES: usize = 1 << 30;
/// Longest stage of a model that sleeps: a day. Milliseconds.
const MAX_STAGE_MS: usize = 24 * 3600 * 1000;

/// `[[model]]`: one model that this host offers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum ModelConfig {
    /// A model in ONNX form, run by ONNX Runtime.
    Onnx(OnnxConfig),
    /// A Python object of the user's own with `infer(x)`.
    Python(PythonModelConfig),
    /// A program of your own: docs/external-programs.md.
    Exec(ExecModelConfig),
    /// Answers with what it was given, at once: measures everything around a model.
    Echo(EchoConfig),
    /// Takes the time it is told to: a model of known latency.
    Sleep(SleepConfig),
}

/// `kind = "onnx"`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnnxConfig {
    /// The name under which peers ask for it.
    pub name: Slug,
    /// The folder with `model.onnx` and its card `model.toml`.
    pub path: PathBuf,
    /// `cpu`, `cuda:0`, `tensorrt:0`, `openvino:CPU`: the whole model runs there or is refused.
    #[serde(default = "cpu")]
    pub device: String,
    /// Threads that compute, each on a sample of its own.
    #[serde(default = "one")]
    pub workers: NonZeroUsize,
    /// Samples that may wait for a free worker; more are refused.
    #[serde(default = "sixteen")]
    pub queue: NonZeroUsize,
    /// Threads of each worker within one operator of the model; the worker's own thread counts.
    #[serde(default = "one")]
    pub intra_threads: NonZeroUsize,
    /// Threads of each worker across independent operators; above 1 they run in parallel.
    #[serde(default = "one")]
    pub inter_threads: NonZeroUsize,
}

/// `kind = "echo"`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EchoConfig {
    /// The name under which peers ask for it.
    pub name: Slug,
    /// Answer with this many bytes instead of the payload.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer_bytes: Option<usize>,
}

/// `kind = "sleep"`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SleepConfig {
    /// The name under which peers ask for it.
    pub name: Slug,
    /// Milliseconds of `preprocessing`.
    #[serde(default = "ten_ms")]
    pub preprocessing_ms: u32,
    /// Milliseconds of `inference`.
    #[serde(default = "eighty_ms")]
    pub inference_ms: u32,
    /// Milliseconds of `postprocessing`.
    #[serde(default = "ten_ms")]
    pub postprocessing_ms: u32,
    /// Threads that sleep, each over a sample of its own.
    #[serde(default = "one")]
    pub workers: NonZeroUsize,
    /// Samples that may wait for a free worker; more are refused.
    #[serde(default = "sixteen")]
    pub queue: NonZeroUsize,
}

/// `[onnxruntime]`: which library runs the models of kind `onnx`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnnxRuntimeConfig {
    /// The library file, or the folder that holds `libonnxruntime.so`. Without it `ORT_DYLIB_PATH`, the folder
    /// `onnxruntime/lib` and the system's library path are searched, in this order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub library: Option<PathBuf>,
}

impl OnnxConfig {
    /// A model in a folder on a device; every other key at its default.
    pub fn new(name: Slug, path: PathBuf, device: &str) -> Self {
        let (workers, queue, intra_threads, inter_threads) = (one(), sixteen(), one(), one());
        Self { name, path, device: device.to_owned(), workers, queue, intra_threads, inter_threads }
    }
}

impl ModelConfig {
    /// The name under which peers ask for it.
    pub fn name(&self) -> &Slug {
        match self {
            Self::Onnx(config) => &config.name,
            Self::Python(config) => &config.name,
            Self::Exec(config) => &config.name,
            Self::Echo(config) => &config.name,
            Self::Sleep(config) => &config.name,
        }
    }

    /// The device it is configured for.
    pub fn device(&self) -> &str {
        match self {
            Self::Onnx(config) => &config.device,
            Self::Python(config) => &config.device,
            Self::Exec(config) => &config.device,
            Self::Echo(_) | Self::Sleep(_) => "cpu",
        }
    }

    /// Takes out what may not be published: the values of `env`.
    pub fn hide_secrets(&mut self) {
        match self {
            Self::Python(config) => hide_values(&mut config.env),
            Self::Exec(config) => hide_values(&mut config.env),
            Self::Onnx(_) | Self::Echo(_) | Self::Sleep(_) => {}
        }
    }

    /// Checks the numbers against their upper limits.
    ///
    /// # Errors
    /// [`LoadError::TooMuch`] for the first that is beyond its own.
    pub fn check_limits(&self) -> Result<(), LoadError> {
        let given: &[(&'static str, usize, usize)] = match self {
            Self::Onnx(config) => &[
                ("intra_threads", config.intra_threads.get(), MAX_THREADS),
                ("inter_threads", config.inter_threads.get(), MAX_THREADS),
            ],
            Self::Echo(config) => &[("answer_bytes", config.answer_bytes.unwrap_or(0), MAX_ANSWER_BYTES)],
            Self::Exec(_) | Self::Python(_) => &[],
            Self::Sleep(config) => &[
                ("preprocessing_ms", config.preprocessing_ms as usize, MAX_STAGE_MS),
                ("inference_ms", config.inference_ms as usize, MAX_STAGE_MS),
                ("postprocessing_ms", config.postprocessing_ms as usize, MAX_STAGE_MS),
            ],
        };
        let of_all = [("workers", self.workers(), MAX_WORKERS), ("queue", self.queue(), MAX_QUEUE)];
        match of_all.iter().chain(given).find(|(_, value, most)| value > most) {
            Some(&(key, value, most)) => {
                Err(LoadError::TooMuch { key, value: value as u64, most: most as u64 })
            }
            None => Ok(()),
        }
    }

    /// Threads that compute; `echo` runs on the thread of its caller and counts as one.
    pub fn workers(&self) -> usize {
        match self {
            Self::Onnx(config) => config.workers.get(),
            Self::Python(config) => config.workers.get(),
            Self::Exec(config) => config.workers.get(),
            Self::Sleep(config) => config.workers.get(),
            Self::Echo(_) => 1,
        }
    }

    /// Samples that may wait for a free worker; `echo` lets none wait.
    pub fn queue(&self) -> usize {
        match self {
            Self::Onnx(config) => config.queue.get(),
            Self::Python(config) => config.queue.get(),
            Self::Exec(config) => config.queue.get(),
            Self::Sleep(config) => config.queue.get(),
            Self::Echo(_) => 1,
        }
    }
}

/// The defaults of keys that several kinds have.
const fn ten_ms() -> u32 {
    10
}

const fn eighty_ms() -> u32 {
    80
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<ModelConfig, toml::de::Error> {
        toml::from_str(text)
    }

    #[test]
    fn the_short_forms_have_sensible_defaults() {
        let onnx = read("name = \"q\"\nkind = \"onnx\"\npath = \"models/q\"").expect("reads");
        assert_eq!((onnx.device(), onnx.workers(), onnx.queue()), ("cpu", 1, 16));
        let ModelConfig::Sleep(sleep) = read("name = \"s\"\nkind = \"sleep\"").expect("reads") else {
            panic!("kind = sleep is a sleep");
        };
        assert_eq!((sleep.preprocessing_ms, sleep.inference_ms, sleep.postprocessing_ms), (10, 80, 10));
    }

    #[test]
    fn a_key_of_another_kind_or_a_misspelt_one_is_refused() {
        let error = read("name = \"e\"\nkind = \"echo\"\nworkers = 2").expect_err("echo has no workers");
        assert!(error.to_string().contains("workers"), "{error}");
        let error = read("name = \"q\"\nkind = \"onnx\"\npath = \"x\"\nworker = 2").expect_err("misspelt");
        assert!(error.to_string().contains("worker"), "{error}");
        assert!(read("name = \"q\"\nkind = \"onnx\"\npath = \"x\"\nworkers = 0").is_err());
    }

    #[test]
    fn every_number_has_an_upper_limit() {
        for (kind, key, most) in [
            ("'onnx'\npath = 'x'", "workers", 256_u64),
            ("'onnx'\npath = 'x'", "queue", 65_536),
            ("'onnx'\npath = 'x'", "intra_threads", 1024),
            ("'onnx'\npath = 'x'", "inter_threads", 1024),
            ("'echo'", "answer_bytes", 1 << 30),
            ("'python'\nobject = 'a::b'", "workers", 256),
            ("'exec'\ncommand = 'x'", "queue", 65_536),
            ("'sleep'", "workers", 256),
            ("'sleep'", "queue", 65_536),
            ("'sleep'", "inference_ms", 86_400_000),
        ] {
            let with = |value| {
                let text = format!("name = 'm'\nkind = {kind}\n{key} = {value}");
                read(&text).expect("reads").check_limits()
            };
            assert!(with(most).is_ok(), "{key}");
            let error = with(most + 1).expect_err(key);
            assert!(matches!(error, LoadError::TooMuch { key: k, .. } if k == key), "{error}");
            assert!(error.to_string().contains(&most.to_string()), "{error}");
        }
    }
}
