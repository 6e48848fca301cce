//! Devices on which ONNX Runtime runs a model.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use ort::ep::{self, ExecutionProvider, ExecutionProviderDispatch};
use peernet_logger::Slug;

use crate::LoadError;

/// Value of `device` of a model of kind `onnx`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Device {
    Cpu,
    Cuda(i32),
    TensorRt(i32),
    /// OpenVINO's name of a device, such as `CPU`, `GPU.0`, `NPU`.
    OpenVino(String),
}

impl FromStr for Device {
    type Err = LoadError;

    fn from_str(text: &str) -> Result<Self, LoadError> {
        let invalid_device = || LoadError::InvalidDevice(text.to_owned());
        let device_index = |text: &str| match text.parse() {
            Ok(index) if index >= 0 => Ok(index),
            _ => Err(invalid_device()),
        };
        match text.split_once(':') {
            None if text == "cpu" => Ok(Self::Cpu),
            Some(("cuda", index)) => device_index(index).map(Self::Cuda),
            Some(("tensorrt", index)) => device_index(index).map(Self::TensorRt),
            Some(("openvino", name)) if !name.is_empty() => Ok(Self::OpenVino(name.to_owned())),
            _ => Err(invalid_device()),
        }
    }
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Cuda(index) => write!(f, "cuda:{index}"),
            Self::TensorRt(index) => write!(f, "tensorrt:{index}"),
            Self::OpenVino(name) => write!(f, "openvino:{name}"),
        }
    }
}

impl Device {
    /// Returns the execution provider of the device; `None` for the CPU, whose provider is in every build of the
    /// library. If the returned provider fails, opening the session fails.
    pub(super) fn provider(&self) -> Option<ExecutionProviderDispatch> {
        let provider = match self {
            Self::Cpu => return None,
            Self::Cuda(index) => ep::CUDA::default().with_device_id(*index).build(),
            Self::TensorRt(index) => ep::TensorRT::default().with_device_id(*index).build(),
            Self::OpenVino(name) => ep::OpenVINO::default().with_device_type(name).build(),
        };
        // Without `error_on_failure`, `ort` logs the error and runs the model on the CPU.
        Some(provider.error_on_failure())
    }

    /// Checks that the loaded library has the execution provider of the device. `library` is the path of the library,
    /// for the error.
    pub(super) fn check(&self, model: &Slug, library: &Path) -> Result<(), LoadError> {
        let available = providers();
        let provider = match self {
            Self::Cpu => ep::CPU::NAME,
            Self::Cuda(_) => ep::CUDA::NAME,
            Self::TensorRt(_) => ep::TensorRT::NAME,
            Self::OpenVino(_) => ep::OpenVINO::NAME,
        };
        if available.contains(&provider) {
            return Ok(());
        }
        Err(LoadError::NoProvider {
            model: model.to_string(),
            device: self.to_string(),
            provider,
            library: library.to_owned(),
            available,
        })
    }
}

/// Returns those execution providers of the loaded library that belong to a kind of device.
fn providers() -> Vec<&'static str> {
    let known = [
        (ep::CPU::NAME, ep::CPU::is_available()),
        (ep::CUDA::NAME, ep::CUDA::is_available()),
        (ep::TensorRT::NAME, ep::TensorRT::is_available()),
        (ep::OpenVINO::NAME, ep::OpenVINO::is_available()),
    ];
    known.into_iter().filter(|(_, available)| matches!(available, Ok(true))).map(|(name, _)| name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_read_as_they_are_written() {
        for text in ["cpu", "cuda:0", "cuda:3", "tensorrt:1", "openvino:CPU", "openvino:GPU.0"] {
            assert_eq!(text.parse::<Device>().expect(text).to_string(), text);
        }
        for text in
            ["", "CPU", "gpu", "cuda", "cuda:", "cuda:-1", "cuda:x", "tensorrt:", "openvino:", "openvino"]
        {
            assert!(matches!(text.parse::<Device>(), Err(LoadError::InvalidDevice(_))), "{text}");
        }
    }
}
