//! Sensor kind `ros`: the messages of a topic of ROS 1 or ROS 2.

mod image;
mod payload;

use std::num::{NonZeroU32, NonZeroU64};
use std::time::Duration;

use peernet_clock::{OneWayDelay, SharedClock, Stamp, WallTime};
use peernet_logger::{Measure, Name, Recorder, Unit, stage};
use peernet_ros::ros2::{QosProfile, Reliability};
use peernet_ros::topics::{
    MessageType, ReaderOptions, RosVersion, TopicAccess, TopicError, TopicMessage, TopicReader, check_topic,
    check_topic_at_master,
};
use peernet_sample::Sample;
use serde::{Deserialize, Serialize};

use self::payload::Payload;
use super::SensorKind;
use crate::{Sensor, SensorError};

/// Transit from `header.stamp` of a message to the arrival of the message at this host, with both stamps. There is no
/// clock relation for the transit, because ROS does not say which clock made a stamp.
const CAPTURE_DELAY: Name = Name::from_static("capture-delay");

/// Configuration of the sensor: `{ kind = "ros", … }`. Each sample is a message of the topic.
///
/// Environment variables select the master of ROS 1 and the domain of ROS 2, as for every ROS node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RosSensorConfig {
    /// Name of the topic; a relative name is below `ROS_NAMESPACE` in ROS 1.
    pub topic: String,
    /// Type of the messages. ROS 2 needs it; without it ROS 1 accepts the published type.
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    pub message_type: Option<MessageType>,
    /// ROS version, 1 or 2. Default: the value of `ROS_VERSION`, else the version of `ROS_DISTRO`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ros_version: Option<RosVersion>,
    /// Maximum number of messages that wait while the pipeline is busy, 1 to 8192. If more messages arrive, the oldest
    /// message is dropped and counted, because a robot needs the newest message. Default: 1.
    #[serde(default = "one_message")]
    pub queue: NonZeroU32,
    /// Longest wait for a message, milliseconds. Default: 5000.
    #[serde(default = "five_seconds")]
    pub timeout_ms: NonZeroU64,
    /// Reliability policy of the ROS 2 subscription: whether lost messages are sent again. Default: `reliable`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reliability: Option<Reliability>,
    /// Clock of `header.stamp`. Default: `unknown`.
    #[serde(default)]
    pub stamp_clock: StampClock,
}

/// Clock of `header.stamp`, which ROS does not name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StampClock {
    /// An unknown clock: of another host, of a device, or simulated. `capture-delay` then has both stamps and no value.
    #[default]
    Unknown,
    /// The wall clock of this host: the publisher runs on this host and stamps with the time of day.
    Host,
}

const fn one_message() -> NonZeroU32 {
    NonZeroU32::MIN
}

fn five_seconds() -> NonZeroU64 {
    NonZeroU64::new(5000).unwrap_or(NonZeroU64::MIN)
}

impl RosSensorConfig {
    /// Checks the configuration, and returns the version of ROS.
    fn validated_version(&self) -> Result<RosVersion, SensorError> {
        let version = check_topic(self.ros_version, &self.topic, self.message_type.as_ref())?;
        let config_error = |reason: &str| Err(SensorError::Config(format!("a ros sensor {reason}")));
        if self.queue.get() > QosProfile::MAX_DEPTH {
            return config_error("queues at most 8192 messages; lower its queue");
        }
        if version == RosVersion::Ros1 && self.reliability.is_some() {
            return config_error(
                "of ROS 1 takes no key reliability, because TCP loses no message; remove it",
            );
        }
        Ok(version)
    }
}

impl SensorKind for RosSensorConfig {
    /// Opens the sensor. The first sample subscribes to the topic.
    // If `open` subscribed, a missing master would fail the whole pipeline instead of single iterations.
    fn open(&self, clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
        let version = self.validated_version()?;
        let options =
            ReaderOptions { queue: self.queue.get(), reliability: self.reliability.unwrap_or_default() };
        let (config, clock) = (self.clone(), SharedClock::clone(clock));
        Ok(Box::new(RosSensor { config, version, options, clock, reader: None }))
    }

    // A missing master or topic is a remark and not an error, because the master may start and the topic may be
    // published later: an agent that the host starts before the master must not fail.
    fn remarks(&self) -> Vec<String> {
        let Ok(version) = self.validated_version() else { return Vec::new() };
        match check_topic_at_master(version, &self.topic, self.message_type.as_ref(), TopicAccess::Read) {
            Ok(remark) => remark.into_iter().collect(),
            Err(error) => vec![error.to_string()],
        }
    }
}

/// Sensor that reads messages of a topic. The first call of `sample` subscribes to the topic.
struct RosSensor {
    config: RosSensorConfig,
    version: RosVersion,
    options: ReaderOptions,
    clock: SharedClock,
    /// The subscriber; `None` before the first sample, and after the node of the subscriber has ended.
    reader: Option<TopicReader>,
}

impl RosSensor {
    fn read(&mut self) -> Result<TopicMessage, TopicError> {
        let config = &self.config;
        let reader = match &mut self.reader {
            Some(reader) => reader,
            empty => empty.insert(TopicReader::open(
                self.version,
                &config.topic,
                config.message_type.as_ref(),
                self.options,
                &self.clock,
            )?),
        };
        let read = reader.read(Duration::from_millis(config.timeout_ms.get()));
        if let Err(error) = &read
            && error.needs_reopening()
        {
            // The next sample starts another node and subscribes again.
            self.reader = None;
        }
        read
    }

    /// Records the capture time and the arrival. The delay between them is known only if one clock made both stamps.
    fn record_stamp(&self, stamp: WallTime, received: WallTime, recorder: &mut Recorder) {
        let difference = received - stamp;
        let delay = match self.config.stamp_clock {
            StampClock::Host => OneWayDelay::same_clock(difference),
            StampClock::Unknown => OneWayDelay::unsynchronised(difference),
        };
        // The start of a node is a time of this host's monotonic clock. The capture time is not known on that clock, so
        // the node starts now.
        let sent = Stamp { wall: stamp, mono: recorder.clock().mono(), ..Stamp::default() };
        let node = recorder.start_transit(CAPTURE_DELAY, sent);
        recorder.end_transit(node, received);
        if let Some(Measure::Transit(transit)) = recorder.tree_mut().measure_mut(node) {
            transit.delay = Some(delay);
        }
    }
}

impl Sensor for RosSensor {
    fn sample(&mut self, recorder: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let message = self.read()?;
        // The value is recorded before decoding, so that an undecodable message does not lose it.
        recorder.record_value(stage::DROPPED_SAMPLES, message.dropped as f64, Unit::NONE);
        let payload = Payload::decode(&message).map_err(|error| SensorError::Message {
            topic: self.config.topic.clone(),
            type_name: message.type_name.to_string(),
            reason: error.to_string(),
        })?;
        if let Some(stamp) = payload.stamp {
            self.record_stamp(stamp, message.received, recorder);
        }
        Ok(Some(Sample { parts: payload.parts, source: self.config.topic.clone(), label: None }))
    }

    fn facts(&self) -> Vec<(String, String)> {
        let type_name = self.config.message_type.as_ref().map_or("any type", MessageType::as_str);
        let topic = format!("{} topic {} ({type_name})", self.version, self.config.topic);
        let clock = match self.config.stamp_clock {
            StampClock::Host => "header.stamp of each message, by the wall clock of this host",
            StampClock::Unknown => "header.stamp of each message, by a clock that is not known",
        };
        vec![("Sensor".to_owned(), topic), ("Capture time".to_owned(), clock.to_owned())]
    }
}
