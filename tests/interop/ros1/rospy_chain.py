"""A rospy node of a chain: a camera, or a relay that answers after a known time.

rospy_chain.py camera NAME TOPIC HZ
rospy_chain.py relay NAME IN OUT DELAY_S
A relay prints the median of its real processing times, in seconds, after each 20 messages.
"""
import statistics
import sys
import time

import rospy
from sensor_msgs.msg import CompressedImage


def print_line(line):
    print(line, flush=True)


def camera(topic, hz):
    publisher = rospy.Publisher(topic, CompressedImage, queue_size=10)
    print_line("ready")
    rate = rospy.Rate(float(hz))
    while not rospy.is_shutdown():
        message = CompressedImage(format="jpeg", data=bytes(10_000))
        message.header.stamp = rospy.Time.now()
        publisher.publish(message)
        rate.sleep()


def relay(source, target, delay):
    publisher = rospy.Publisher(target, CompressedImage, queue_size=10)
    durations = []

    def answer(message):
        start = time.monotonic()
        time.sleep(float(delay))
        publisher.publish(message)
        durations.append(time.monotonic() - start)
        if len(durations) == 20:
            print_line(f"median {statistics.median(durations)}")
            durations.clear()

    rospy.Subscriber(source, CompressedImage, answer, tcp_nodelay=True)
    print_line("ready")
    rospy.spin()


command, name, *arguments = sys.argv[1:]
rospy.init_node(name, disable_signals=True)
{"camera": camera, "relay": relay}[command](*arguments)
