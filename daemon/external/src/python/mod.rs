//! A custom Python object (`module::object`) in a separate process.
//!
//! The process runs the worker program ([`SOURCE`]), which needs only Python's standard library. The worker imports the
//! object's module from the configured folder, instantiates the class, and then answers one call after the other:
//! `sample()` of a sensor, `preprocess`, `infer` and `postprocess` of a model, or `act()` of an actuator; `reset()`
//! prepares a sensor or an actuator for an episode. Values are transferred as the parts of a sample (`values.py` defines
//! the conversion). Therefore a Python object can take the values of another Python object, even if transforms or a
//! network are between the two objects.
//!
//! Before any custom code runs, the worker moves the pipes to other descriptors and replaces standard input and output,
//! so that printed text cannot get between the messages.

mod call_result;
mod config;
mod error;
mod frame;
mod interpreter;
mod object;
mod object_description;
mod shared_memory;
mod worker;

pub use call_result::{CallResult, CallTimes, Step};
pub use config::{Images, PythonConfig};
pub use error::PythonError;
pub use frame::{FrameError, PICKLE, TREE};
pub use object::PythonObject;
pub use object_description::ObjectDescription;

pub use crate::role::Role;

/// Source code of the worker program, which the Python process runs.
const SOURCE: &str = concat!(
    include_str!("values.py"),
    include_str!("channel.py"),
    include_str!("imports.py"),
    include_str!("worker.py")
);
