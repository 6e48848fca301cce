//! Environment variables that influence custom code, and the protection of configured variables.

use std::collections::BTreeMap;
use std::env;

use peernet_sample::printable_line;

/// Recorded variables: those of PEERNet, Python, the dynamic loader, thread pools and GPUs. The values of other
/// variables may be secret.
const RECORDED_VARIABLES: [&str; 26] = [
    "PEERNET_PYTHON",
    "PEERNET_MODELS",
    "ORT_DYLIB_PATH",
    "PYTHONPATH",
    "PYTHONHOME",
    "PYTHONHASHSEED",
    "PYTHONOPTIMIZE",
    "VIRTUAL_ENV",
    "CONDA_PREFIX",
    "LD_LIBRARY_PATH",
    "LD_PRELOAD",
    "OMP_NUM_THREADS",
    "OMP_PROC_BIND",
    "OMP_PLACES",
    "OMP_WAIT_POLICY",
    "KMP_AFFINITY",
    "KMP_BLOCKTIME",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "CUDA_VISIBLE_DEVICES",
    "CUDA_DEVICE_ORDER",
    "CUDA_LAUNCH_BLOCKING",
    "CUBLAS_WORKSPACE_CONFIG",
    "NVIDIA_TF32_OVERRIDE",
    "PYTORCH_CUDA_ALLOC_CONF",
];
/// Variable of custom code in an experiment: a seed, which is a number of at most 53 bits. The seed depends on the
/// repeat, on the user, and on whether the custom code is the sensor, the actuator or a model. A *user* of an
/// experiment is one of the edges that use the cloud at the same time.
pub const SEED_VARIABLE: &str = "PEERNET_SEED";
/// Variable of custom code in an experiment: the number of the repeat, from 1.
pub const REPEAT_VARIABLE: &str = "PEERNET_REPEAT";
/// Variable of custom code in an experiment: the number of the user, from 1.
pub const USER_VARIABLE: &str = "PEERNET_USER";
/// Variable of a model: the device for which it is configured.
pub const DEVICE_VARIABLE: &str = "PEERNET_DEVICE";
/// Longest recorded value, characters.
const MAX_VALUE_CHARS: usize = 1000;
/// Text that replaces a configured value.
const HIDDEN_VALUE: &str = "(not told)";

/// Returns the variables in PEERNet's own environment that influence the results of custom code, with their values. The
/// processes of custom code inherit these variables.
pub fn environment() -> BTreeMap<String, String> {
    let value_of = |name: &&str| {
        let value = env::var_os(name)?.to_string_lossy().chars().take(MAX_VALUE_CHARS).collect::<String>();
        Some(((*name).to_owned(), printable_line(&value).into_owned()))
    };
    RECORDED_VARIABLES.iter().filter_map(value_of).collect()
}

/// Replaces the values of configured variables (`env`) in a configuration that is published, because the values may be
/// secret. The numbers of a run ([`SEED_VARIABLE`], [`REPEAT_VARIABLE`], [`USER_VARIABLE`]) stay, because they are needed
/// to repeat the run.
pub fn hide_values(variables: &mut BTreeMap<String, String>) {
    let is_number_of_run = |name: &str, value: &str| {
        [SEED_VARIABLE, REPEAT_VARIABLE, USER_VARIABLE].contains(&name) && value.parse::<u64>().is_ok()
    };
    for (name, value) in variables {
        if !is_number_of_run(name, value) {
            HIDDEN_VALUE.clone_into(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_hidden_except_numbers_of_run() {
        let pairs = [("PEERNET_SEED", "7"), ("PEERNET_USER", "ann"), ("TOKEN", "8")];
        let mut variables = pairs.map(|(name, value)| (name.to_owned(), value.to_owned())).into();
        hide_values(&mut variables);
        let values: Vec<&str> = variables.values().map(String::as_str).collect();
        assert_eq!(values, ["7", HIDDEN_VALUE, HIDDEN_VALUE]);
    }
}
