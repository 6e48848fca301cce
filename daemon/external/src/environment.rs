//! Environment variables: those that decide what code finds and how fast it computes, and those that users set.

use std::collections::BTreeMap;
use std::env;

use peernet_sample::printable_line;

/// Ours, those of Python, of the loader, of thread pools and of GPUs. Others may be secret and are nobody's business.
const NAMES: [&str; 26] = [
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
/// Characters of the longest value that is told.
const LONGEST: usize = 1000;
/// What stands in the place of a value that a user set.
const NOT_TOLD: &str = "(not told)";

/// Those that this program has, with their values, which users' processes inherit.
pub fn environment() -> BTreeMap<String, String> {
    let told = |name: &&str| {
        let value = env::var_os(name)?.to_string_lossy().chars().take(LONGEST).collect::<String>();
        Some(((*name).to_owned(), printable_line(&value).into_owned()))
    };
    NAMES.iter().filter_map(told).collect()
}

/// Leaves the names of what users set (`env`), for a configuration that is published: the values may be secret.
pub fn hide_values(variables: &mut BTreeMap<String, String>) {
    variables.values_mut().for_each(|value| NOT_TOLD.clone_into(value));
}
