//! Pipelines: sensor → transforms → placement → actuator, again and again.
//!
//! `load`, `progress` and `backoff` decide without I/O; `pipeline_loop` is the state of the inner loop and
//! `drive` its waiting; `runner` is the life around it. `observe` is the loop of a pipeline that only watches a ROS system.

mod accuracy;
mod actuator_executor;
mod backoff;
mod context;
mod deadline;
mod drive;
mod failure_log;
mod in_flight;
mod iteration;
mod load;
mod observe;
mod pipeline_loop;
mod placement;
mod progress;
mod resources;
mod run;
mod runner;
mod sensing;
mod start_timer;

pub(crate) use context::PipelineContext;
pub(crate) use placement::intended;
pub(crate) use runner::run;
