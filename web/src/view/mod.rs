//! What several pages say the same way.

pub(crate) mod bytes;
pub(crate) mod cause;
pub(crate) mod chart;
pub(crate) mod chip;
pub(crate) mod clocks;
pub(crate) mod cut;
pub(crate) mod data;
pub(crate) mod health;
pub(crate) mod hosts;
pub(crate) mod incidents;
pub(crate) mod now;
pub(crate) mod place;
pub(crate) mod run;
pub(crate) mod runs;
#[cfg(test)]
pub(crate) mod samples;
pub(crate) mod shell;
pub(crate) mod speed;
pub(crate) mod stack;
pub(crate) mod stages;
pub(crate) mod timeline;
pub(crate) mod waterfall;
