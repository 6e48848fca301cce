//! Roles of custom code.

use serde::Serialize;

/// Role of custom code in a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// Produces samples. A Python object has `sample()`, and may have `reset()` and `advance(seconds)`.
    Sensor,
    /// Answers samples. A Python object has `infer(x)`, and may have `preprocess(x)` and `postprocess(y)`.
    Model,
    /// Acts on answers. A Python object has `act(answer)`, and may have `reset()`.
    Actuator,
}

impl Role {
    /// Returns the role's name, as in the program's environment and in messages.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Sensor => "sensor",
            Self::Model => "model",
            Self::Actuator => "actuator",
        }
    }

    /// Returns the role's name with its article, for messages.
    pub(crate) const fn with_article(self) -> &'static str {
        match self {
            Self::Sensor => "a sensor",
            Self::Model => "a model",
            Self::Actuator => "an actuator",
        }
    }

    /// Returns the role's name as it begins the names of a run's facts, such as `Sensor arguments`.
    pub(crate) const fn fact_prefix(self) -> &'static str {
        match self {
            Self::Sensor => "Sensor",
            Self::Model => "Model",
            Self::Actuator => "Actuator",
        }
    }
}
