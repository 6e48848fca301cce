//! Telemetry of ONNX Runtime, which is switched off.

/// Variable that switches the telemetry of ONNX Runtime off (its docs/Privacy.md).
const VARIABLE: &str = "ORT_DISABLE_TELEMETRY";

/// Switches the telemetry of ONNX Runtime off, unless the variable is set by the user. Must be called before any
/// thread is started.
// From 1.29 on, Microsoft's builds for Linux write an identifier into the user's home and send a description of each
// process and model to Microsoft. A program on a robot must not do that, and uploads disturb what it measures. The
// library's function for the same purpose comes too late: it needs an environment, whose creation already sends the
// first event.
#[expect(
    unsafe_code,
    reason = "another thread might read the environment at the same time, and there is none yet"
)]
pub fn disable_library_telemetry() {
    if std::env::var_os(VARIABLE).is_none() {
        // SAFETY: the caller has started no thread.
        unsafe { std::env::set_var(VARIABLE, "1") };
    }
}
