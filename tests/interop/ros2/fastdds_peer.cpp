// Peer of the ROS 2 interoperability tests that uses eProsima Fast DDS, with hand-written types.
//
// fastdds_peer publish|receive TOPIC string|image COUNT BYTES [SOCKET_BUFFER_BYTES]

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <chrono>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <string>
#include <thread>
#include <vector>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using Bytes = std::vector<unsigned char>;

static const eprosima::fastrtps::Duration_t time_limit{20, 0};

// A message that is serialised already, with its encapsulation header.
class RawType : public TopicDataType {
public:
    explicit RawType(const char* name) {
        setName(name);
        m_typeSize = 8 << 20;
        m_isGetKeyDefined = false;
    }
    bool serialize(void* data, SerializedPayload_t* payload) override {
        const Bytes& bytes = *static_cast<Bytes*>(data);
        if (payload->max_size < bytes.size()) return false;
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = CDR_LE;
        return true;
    }
    bool deserialize(SerializedPayload_t* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
    }
    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

static void put(Bytes& to, uint32_t value) {
    for (int shift = 0; shift < 32; shift += 8) to.push_back((value >> shift) & 255);
}

static Bytes message(bool is_string, size_t size, size_t number) {
    Bytes bytes{0, 1, 0, 0};
    if (is_string) {
        put(bytes, size + 1);
        for (size_t i = 0; i < size; ++i) bytes.push_back('a' + (i + number) % 26);
        bytes.push_back(0);
        return bytes;
    }
    put(bytes, number);
    put(bytes, 7);
    const char strings[] = "\x04\0\0\0cam\0\x05\0\0\0jpeg\0\0\0";
    bytes.insert(bytes.end(), strings, strings + sizeof strings);
    put(bytes, size);
    for (size_t i = 0; i < size; ++i) bytes.push_back((i * 31 + number) % 256);
    return bytes;
}

static int fail(const std::string& text) {
    std::cerr << "fastdds: " << text << "\n";
    return 1;
}

int main(int argc, char** argv) {
    if (argc < 6) return fail("publish|receive TOPIC string|image COUNT BYTES [SOCKET_BUFFER_BYTES]");
    const bool publishes = argv[1] == std::string("publish"), is_string = argv[3] == std::string("string");
    const size_t count = std::stoul(argv[4]), size = std::stoul(argv[5]);
    const char* domain = std::getenv("ROS_DOMAIN_ID");

    DomainParticipantQos participant_qos;
    // Only UDP over loopback. Shared memory would only reach another Fast DDS.
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList.push_back("127.0.0.1");
    participant_qos.transport().use_builtin_transports = false;
    participant_qos.transport().user_transports.push_back(udp);
    if (argc > 6) {
        udp->receiveBufferSize = udp->sendBufferSize = std::stoul(argv[6]);
    }
    // Multicast does not work on a loopback interface: the first participants of the host are asked directly.
    for (uint32_t id = 0; id < 4; ++id) {
        eprosima::fastrtps::rtps::Locator_t peer;
        eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, "127.0.0.1");
        peer.port = 7400 + 250 * (domain ? std::stoul(domain) : 0) + 10 + 2 * id;
        participant_qos.wire_protocol().builtin.initialPeersList.push_back(peer);
    }
    auto* factory = DomainParticipantFactory::get_instance();
    auto* participant = factory->create_participant(domain ? std::stoul(domain) : 0, participant_qos);
    if (!participant) return fail("no participant");
    TypeSupport type(new RawType(is_string ? "std_msgs::msg::dds_::String_" : "sensor_msgs::msg::dds_::CompressedImage_"));
    type.register_type(participant);
    auto* topic = participant->create_topic(std::string("rt") + argv[2], type.get_type_name(), TOPIC_QOS_DEFAULT);
    int result = 0;
    if (publishes) {
        DataWriterQos qos;
        qos.history().kind = KEEP_ALL_HISTORY_QOS;
        qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
        qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::DYNAMIC_RESERVE_MEMORY_MODE;
        auto* writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
        PublicationMatchedStatus status{};
        for (int tries = 0; status.current_count == 0 && tries < 400; ++tries) {
            std::this_thread::sleep_for(std::chrono::milliseconds(50));
            writer->get_publication_matched_status(status);
        }
        if (status.current_count == 0) return fail("no subscription was found in time");
        // The subscription may not have discovered this publisher yet; it would miss earlier messages.
        std::this_thread::sleep_for(std::chrono::seconds(1));
        for (size_t number = 0; number < count; ++number) {
            Bytes bytes = message(is_string, size, number);
            if (!writer->write(&bytes)) return fail("cannot write message " + std::to_string(number));
        }
        if (writer->wait_for_acknowledgments(time_limit) != ReturnCode_t::RETCODE_OK)
            return fail("some messages were not acknowledged in time");
        // rustdds drops what was not read before its publisher leaves.
        std::this_thread::sleep_for(std::chrono::seconds(1));
        std::cout << "published and acknowledged: " << count << "\n";
    } else {
        DataReaderQos qos;
        qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
        qos.history().kind = KEEP_ALL_HISTORY_QOS;
        qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::DYNAMIC_RESERVE_MEMORY_MODE;
        auto* reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, qos);
        for (size_t number = 0; number < count && result == 0; ++number) {
            Bytes bytes;
            SampleInfo info;
            if (!reader->wait_for_unread_message(time_limit)) {
                result = fail("message " + std::to_string(number) + " of " + std::to_string(count) + " did not arrive");
            } else if (reader->take_next_sample(&bytes, &info) != ReturnCode_t::RETCODE_OK) {
                result = fail("cannot take message " + std::to_string(number));
            } else {
                const Bytes expected = message(is_string, size, number);
                if (bytes.size() < expected.size() || std::memcmp(bytes.data(), expected.data(), expected.size()) != 0)
                    result = fail("message " + std::to_string(number) + " differs from the published one");
            }
        }
        if (result == 0) std::cout << "received unchanged: " << count << "\n";
    }
    participant->delete_contained_entities();
    factory->delete_participant(participant);
    return result;
}
