//! Pipelines: sensor → transforms → placement → actuator, again and again.
//!
//! `load`, `progress` and `brake` decide without I/O; `cycle` is the state of the inner loop and
//! `drive` its waiting; `runner` is the life around it. `observe` is the loop of a pipeline that only watches a ROS system.

mod accuracy;
mod acting;
mod alarm;
mod brake;
mod context;
mod cycle;
mod deadline;
mod drive;
mod flight;
mod iteration;
mod line;
mod load;
mod observe;
mod placement;
mod progress;
mod run;
mod runner;
mod sensing;

pub(crate) use context::PipelineContext;
pub(crate) use placement::intended;
pub(crate) use runner::run;
