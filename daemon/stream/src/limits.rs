//! Limits of a live update.

/// Links of a live update.
pub const MAX_LINKS: usize = 1024;

/// Kinds of network of a link.
pub const MAX_NETWORKS: usize = 64;

/// Pipelines of a host, which may all use one link.
pub const MAX_PIPELINES: usize = 256;
