"""A rospy node of a chain: a camera, or a node that answers after a known time.

rospy_chain.py camera NAME TOPIC HZ
rospy_chain.py relay NAME IN OUT DELAY_S
A relay prints the median of what it really took, in seconds, after each 20 messages.
"""
import statistics
import sys
import time

import rospy
from sensor_msgs.msg import CompressedImage


def say(line):
    print(line, flush=True)


def camera(topic, hz):
    publisher = rospy.Publisher(topic, CompressedImage, queue_size=10)
    say("ready")
    rate = rospy.Rate(float(hz))
    while not rospy.is_shutdown():
        message = CompressedImage(format="jpeg", data=bytes(10_000))
        message.header.stamp = rospy.Time.now()
        publisher.publish(message)
        rate.sleep()


def relay(source, target, delay):
    publisher = rospy.Publisher(target, CompressedImage, queue_size=10)
    taken = []

    def answer(message):
        begun = time.monotonic()
        time.sleep(float(delay))
        publisher.publish(message)
        taken.append(time.monotonic() - begun)
        if len(taken) == 20:
            say(f"median {statistics.median(taken)}")
            taken.clear()

    rospy.Subscriber(source, CompressedImage, answer, tcp_nodelay=True)
    say("ready")
    rospy.spin()


command, name, *arguments = sys.argv[1:]
rospy.init_node(name, disable_signals=True)
{"camera": camera, "relay": relay}[command](*arguments)
