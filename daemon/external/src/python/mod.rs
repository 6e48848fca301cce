//! A user's Python object (`module::object`) in a process of its own.
//!
//! The process runs [`SOURCE`] with nothing but Python's standard library. It imports the user's module from its folder,
//! instantiates a class, and then answers one call after the other: `sample()` of a sensor, or `preprocess`, `infer` and
//! `postprocess` of a model. Values cross as parts of a sample (`values.py` says how), so that what one Python object
//! yields another takes, and everything else in a pipeline can be between them or in their place.

mod called;
mod config;
mod error;
mod frame;
mod interpreter;
mod object;
mod window;
mod worker;

pub use called::{Called, Stage, Times};
pub use config::{Images, PythonConfig};
pub use error::PythonError;
pub use frame::{FrameError, PICKLE};
pub use object::{About, PythonObject, Role};

/// What the process runs.
const SOURCE: &str = concat!(
    include_str!("values.py"),
    include_str!("border.py"),
    include_str!("imports.py"),
    include_str!("worker.py")
);
