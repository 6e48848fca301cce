//! The frames of a message in its companion and its payload message.

use bytes::{Bytes, BytesMut};
use peernet_ros::messages::MessageInfo;

use crate::message::MAX_FRAMES;
use crate::transport::Frames;

/// Index of the frame that may be sent as a payload message: the first part of the sample.
pub(super) const PAYLOAD_FRAME: usize = 2;

/// Packs frames into a companion, without the frame that is sent as a payload message. Returns `false` if a frame is
/// too long for its length field.
pub(super) fn pack(info: &mut MessageInfo, frames: &[Bytes], has_payload: bool) -> bool {
    let length = |frame: &Bytes| u32::try_from(frame.len()).ok();
    let Some(lengths) = frames.iter().map(length).collect::<Option<Vec<u32>>>() else { return false };
    let companion_frames =
        frames.iter().enumerate().filter(|(index, _)| !(has_payload && *index == PAYLOAD_FRAME));
    let companion_frames: Vec<&Bytes> = companion_frames.map(|(_, frame)| frame).collect();
    info.frames = match companion_frames[..] {
        // A single frame is shared; several have to be copied into one buffer.
        [single_frame] => single_frame.clone(),
        _ => {
            let mut joined = BytesMut::with_capacity(companion_frames.iter().map(|frame| frame.len()).sum());
            companion_frames.iter().for_each(|frame| joined.extend_from_slice(frame));
            joined.freeze()
        }
    };
    info.frame_lengths = lengths;
    info.has_payload = has_payload;
    true
}

/// Reason why a companion and its payload do not form a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum FramesError {
    #[error("the message has {0} frames, more than {MAX_FRAMES}")]
    TooMany(usize),
    #[error("the message has {bytes} bytes, more than max_message_bytes, {max_bytes}")]
    TooLarge { bytes: u64, max_bytes: u64 },
    #[error("the frames have other lengths than the message announces")]
    Lengths,
}

/// Returns the sum of the lengths of all frames that a companion announces. Bytes.
pub(super) fn announced_bytes(info: &MessageInfo) -> u64 {
    info.frame_lengths.iter().map(|length| u64::from(*length)).sum()
}

/// Checks the lengths that a companion announces.
pub(super) fn check_lengths(info: &MessageInfo, max_bytes: u64) -> Result<(), FramesError> {
    if info.frame_lengths.len() > MAX_FRAMES {
        return Err(FramesError::TooMany(info.frame_lengths.len()));
    }
    let bytes = announced_bytes(info);
    if bytes > max_bytes {
        return Err(FramesError::TooLarge { bytes, max_bytes });
    }
    let payload_bytes = match (info.has_payload, info.frame_lengths.get(PAYLOAD_FRAME)) {
        (false, _) => 0,
        (true, Some(length)) => u64::from(*length),
        (true, None) => return Err(FramesError::Lengths),
    };
    if info.frames.len() as u64 == bytes - payload_bytes { Ok(()) } else { Err(FramesError::Lengths) }
}

/// Returns the frames of a checked companion and its payload.
pub(super) fn unpack(info: &MessageInfo, payload: Option<&Bytes>) -> Result<Frames, FramesError> {
    let mut rest = info.frames.clone();
    let take_frame = |(index, length): (usize, &u32)| {
        let length = usize::try_from(*length).map_err(|_| FramesError::Lengths)?;
        match payload.filter(|_| index == PAYLOAD_FRAME) {
            Some(payload) if payload.len() == length => Ok(payload.clone()),
            Some(_) => Err(FramesError::Lengths),
            None if length <= rest.len() => Ok(rest.split_to(length)),
            None => Err(FramesError::Lengths),
        }
    };
    info.frame_lengths.iter().enumerate().map(take_frame).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn frames_are_unpacked_as_packed(
            frames in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..20), 0..6),
            wants_payload: bool,
        ) {
            let frames: Frames = frames.into_iter().map(Bytes::from).collect();
            let has_payload = wants_payload && frames.len() > PAYLOAD_FRAME;
            let mut info = MessageInfo::default();
            prop_assert!(pack(&mut info, &frames, has_payload));
            prop_assert_eq!(check_lengths(&info, 1_000), Ok(()));
            let payload = has_payload.then(|| frames[PAYLOAD_FRAME].clone());
            prop_assert_eq!(unpack(&info, payload.as_ref()), Ok(frames));
        }

        #[test]
        fn any_frame_lengths_are_unpacked_without_panic(
            lengths in proptest::collection::vec(any::<u32>(), 0..80),
            frames in proptest::collection::vec(any::<u8>(), 0..40),
            has_payload: bool,
        ) {
            let info = MessageInfo { frame_lengths: lengths, frames: frames.into(), has_payload, ..MessageInfo::default() };
            let payload = Bytes::from_static(b"payload");
            if check_lengths(&info, 1_000).is_ok() {
                let _ = unpack(&info, has_payload.then_some(&payload));
            }
        }
    }
}
