//! Telemetry of ONNX Runtime, which is switched off.

/// Variable that switches the telemetry of ONNX Runtime off (docs/Privacy.md of ONNX Runtime).
const DISABLE_VARIABLE: &str = "ORT_DISABLE_TELEMETRY";

/// Switches the telemetry of ONNX Runtime off, unless the user has set the variable. Must be called before any
/// thread is started.
// From version 1.29 on, Microsoft's builds for Linux write an identifier into the user's home and send a description of
// each process and model to Microsoft. A program on a robot must not do that, and uploads disturb measurements. The
// library's function that disables telemetry comes too late: it needs an environment, whose creation already sends the
// first event.
#[expect(
    unsafe_code,
    reason = "changing the environment is safe only while no other thread reads it, and there is no other thread yet"
)]
pub fn disable_library_telemetry() {
    if std::env::var_os(DISABLE_VARIABLE).is_none() {
        // SAFETY: the caller has started no thread.
        unsafe { std::env::set_var(DISABLE_VARIABLE, "1") };
    }
}
