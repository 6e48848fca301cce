//! Tests of the message types and their wire forms.

mod definitions;
mod layout;
mod mutations;
mod round_trips;

use proptest::prelude::*;

use super::{CompressedImage, Header, Image, Imu, PointCloud2, PointField, Quaternion, Time, Vector3};

prop_compose! {
    fn headers()(seq: u32, sec in 0..i64::from(i32::MAX), nanosec: u32, frame_id in "[^\0]{0,20}") -> Header {
        Header { seq, stamp: Time { sec, nanosec }, frame_id }
    }
}

/// Returns short byte strings, and byte strings whose lengths are near the limit above which bytes are not copied.
fn byte_strings() -> impl Strategy<Value = bytes::Bytes> {
    prop_oneof![0_usize..40, 4090_usize..4100]
        .prop_flat_map(|length| proptest::collection::vec(any::<u8>(), length))
        .prop_map(Into::into)
}

prop_compose! {
    fn images()(
        header in headers(), height: u32, width: u32, encoding in "[^\0]{0,9}", is_bigendian: u8, step: u32, data in byte_strings(),
    ) -> Image {
        Image { header, height, width, encoding, is_bigendian, step, data }
    }
}

prop_compose! {
    fn compressed_images()(header in headers(), format in "[^\0]{0,9}", data in byte_strings()) -> CompressedImage {
        CompressedImage { header, format, data }
    }
}

fn finite_numbers() -> impl Strategy<Value = f64> {
    -1e9..1e9
}

prop_compose! {
    fn vectors()(x in finite_numbers(), y in finite_numbers(), z in finite_numbers()) -> Vector3 {
        Vector3 { x, y, z }
    }
}

prop_compose! {
    fn imus()(
        header in headers(),
        vector in vectors(),
        w in finite_numbers(),
        covariance in proptest::array::uniform9(finite_numbers()),
        angular_velocity in vectors(),
        linear_acceleration in vectors(),
    ) -> Imu {
        Imu {
            header,
            orientation: Quaternion { x: vector.x, y: vector.y, z: vector.z, w },
            orientation_covariance: covariance,
            angular_velocity,
            angular_velocity_covariance: covariance.map(|value| value + 1.0),
            linear_acceleration,
            linear_acceleration_covariance: covariance.map(|value| value - 1.0),
        }
    }
}

prop_compose! {
    fn point_fields()(name in "[^\0]{0,9}", offset: u32, datatype: u8, count: u32) -> PointField {
        PointField { name, offset, datatype, count }
    }
}

prop_compose! {
    fn point_clouds()(
        header in headers(),
        size: (u32, u32, u32, u32),
        fields in proptest::collection::vec(point_fields(), 0..5),
        is_bigendian: bool,
        data in byte_strings(),
        is_dense: bool,
    ) -> PointCloud2 {
        let (height, width, point_step, row_step) = size;
        PointCloud2 { header, height, width, fields, is_bigendian, point_step, row_step, data, is_dense }
    }
}
