//! Tests of MD5 sums, which are computed from the texts of the definitions as genmsg does.

use md5::{Digest, Md5};

use crate::messages::{
    CompressedImage, Header, Image, Imu, Message, MessageDefinition, MessageInfo, PointCloud2, SessionHello,
    StringMessage, UInt8MultiArray,
};

/// Returns the MD5 sum of a definition. The hashed text has the constants and then the fields, each in their order. In
/// this text, the MD5 sum of a message type replaces the name of the type and the brackets of an array.
fn md5_sum(definition: &MessageDefinition) -> String {
    let (constants, fields): (Vec<&str>, Vec<&str>) =
        definition.text.lines().partition(|line| line.contains('='));
    let fields = fields.into_iter().map(|line| {
        let (kind, name) = line.split_once(' ').expect("a type and a name");
        let element = kind.split('[').next().expect("split gives one part at least");
        match definition.dependencies.iter().find(|dependency| dependency.name == element) {
            Some(dependency) => format!("{} {name}", md5_sum(dependency)),
            None => {
                assert!(!element.contains('/'), "{} lacks its dependency {element}", definition.name);
                line.to_owned()
            }
        }
    });
    let lines: Vec<String> = constants.into_iter().map(str::to_owned).chain(fields).collect();
    Md5::digest(lines.join("\n")).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn md5_sums_match_the_definitions() {
    let definitions = [
        &Header::DEFINITION,
        StringMessage::DEFINITION,
        Image::DEFINITION,
        CompressedImage::DEFINITION,
        Imu::DEFINITION,
        PointCloud2::DEFINITION,
        UInt8MultiArray::DEFINITION,
        SessionHello::DEFINITION,
        MessageInfo::DEFINITION,
    ];
    for definition in definitions {
        assert_eq!(definition.md5, md5_sum(definition), "{}", definition.name);
        for dependency in definition.dependencies {
            assert_eq!(dependency.md5, md5_sum(dependency), "{}", dependency.name);
        }
    }
}

#[test]
fn full_text_appends_dependencies() {
    let text = CompressedImage::DEFINITION.full_text();
    let line = "=".repeat(80);
    assert_eq!(
        text,
        format!(
            "std_msgs/Header header\nstring format\nuint8[] data\n\n{line}\nMSG: std_msgs/Header\n\
             uint32 seq\ntime stamp\nstring frame_id\n"
        )
    );
}

#[test]
fn dds_types_follow_the_ros1_names() {
    fn check<M: Message>() {
        let (package, name) = M::DEFINITION.name.split_once('/').expect("package and name");
        assert_eq!(M::DDS_TYPE, format!("{package}::msg::dds_::{name}_"));
    }
    check::<Header>();
    check::<StringMessage>();
    check::<Image>();
    check::<CompressedImage>();
    check::<Imu>();
    check::<PointCloud2>();
    check::<UInt8MultiArray>();
    check::<SessionHello>();
    check::<MessageInfo>();
}
