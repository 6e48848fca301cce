//! Pipelines: sensor → transforms → placement → actuator, repeated.
//!
//! `load`, `progress` and `backoff` compute schedules, limits and pauses without I/O. `pipeline_loop` is the state
//! machine of the inner loop, also without I/O, and `drive` waits for its events. `runner` sets a pipeline up, connects
//! it, and runs it to its end. `observe` is the loop of a pipeline that only observes a ROS system.
//!
//! Before the first sample of an episode the actuator and the sensor are reset. Before every further sample a simulated
//! sensor is advanced by the duration of the previous iteration. The reset and the advance happen between iterations
//! (`preparation`). The feedback of the actuator may end an episode early. `episode_scores` sums up the feedback over
//! the episode.
//!
//! The order of one iteration: `load` returns its intended start, which is the start of the root of its tree. `sensing`
//! requests a sample from the sensor and applies the transforms. The sample waits until fewer iterations than the
//! maximum are in flight (`send-queue`). `placement` gets the answer. Then the actuator runs, unless it has acted on
//! the answer to a newer sample (`superseded`). `iteration` closes the tree, and `run` passes the tree to the live
//! statistics and the event queue. An iteration whose answer is lost or late is recorded as `lost` or `timeout`, never
//! dropped.

mod accuracy;
mod actuator_executor;
mod backoff;
mod context;
mod deadline;
mod drive;
mod episode_scores;
mod failure_log;
mod in_flight;
mod iteration;
mod load;
mod local_requester;
mod observe;
mod peer_problem;
mod pipeline_loop;
mod placement;
mod preparation;
mod progress;
mod resources;
mod run;
mod runner;
mod sensing;
mod start_timer;

pub(crate) use context::PipelineContext;
pub(crate) use placement::describe_planned;
pub(crate) use runner::run;
