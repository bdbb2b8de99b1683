# SPDX-License-Identifier: Apache-2.0
"""Joint orders of body trackers and ROS messages, as data; columns as in `tables`."""

# OpenPose, POSE_COCO_BODY_PARTS; ZED's BODY_18 is the same.
OPENPOSE18 = """
Nose       nose             -
Neck       neck             Nose
RShoulder  right_shoulder   Neck
RElbow     right_elbow      RShoulder
RWrist     right_wrist      RElbow
LShoulder  left_shoulder    Neck
LElbow     left_elbow       LShoulder
LWrist     left_wrist       LElbow
RHip       right_hip        Neck
RKnee      right_knee       RHip
RAnkle     right_ankle      RKnee
LHip       left_hip         Neck
LKnee      left_knee        LHip
LAnkle     left_ankle       LKnee
REye       right_eye        Nose
LEye       left_eye         Nose
REar       right_ear        REye
LEar       left_ear         LEye
"""

# hri_msgs/Skeleton2D (REP 155): OpenPose's order, but for the sides of eyes and ears. The neck is
# no observation: nodes put it in the middle of the shoulders.
HRI18 = """
NOSE            nose             -
NECK            -                NOSE
RIGHT_SHOULDER  right_shoulder   NECK
RIGHT_ELBOW     right_elbow      RIGHT_SHOULDER
RIGHT_WRIST     right_wrist      RIGHT_ELBOW
LEFT_SHOULDER   left_shoulder    NECK
LEFT_ELBOW      left_elbow       LEFT_SHOULDER
LEFT_WRIST      left_wrist       LEFT_ELBOW
RIGHT_HIP       right_hip        NECK
RIGHT_KNEE      right_knee       RIGHT_HIP
RIGHT_ANKLE     right_ankle      RIGHT_KNEE
LEFT_HIP        left_hip         NECK
LEFT_KNEE       left_knee        LEFT_HIP
LEFT_ANKLE      left_ankle       LEFT_KNEE
LEFT_EYE        left_eye         NOSE
RIGHT_EYE       right_eye        NOSE
LEFT_EAR        left_ear         LEFT_EYE
RIGHT_EAR       right_ear        RIGHT_EYE
"""

# ZED SDK, BODY_34.
ZED34 = """
PELVIS          pelvis             -
NAVAL_SPINE     -                  PELVIS
CHEST_SPINE     -                  NAVAL_SPINE
NECK            neck               CHEST_SPINE
LEFT_CLAVICLE   left_clavicle      CHEST_SPINE
LEFT_SHOULDER   left_shoulder      LEFT_CLAVICLE
LEFT_ELBOW      left_elbow         LEFT_SHOULDER
LEFT_WRIST      left_wrist         LEFT_ELBOW
LEFT_HAND       left_hand_zed      LEFT_WRIST
LEFT_HANDTIP    left_handtip_zed   LEFT_HAND
LEFT_THUMB      left_thumb_zed     LEFT_WRIST
RIGHT_CLAVICLE  right_clavicle     CHEST_SPINE
RIGHT_SHOULDER  right_shoulder     RIGHT_CLAVICLE
RIGHT_ELBOW     right_elbow        RIGHT_SHOULDER
RIGHT_WRIST     right_wrist        RIGHT_ELBOW
RIGHT_HAND      right_hand_zed     RIGHT_WRIST
RIGHT_HANDTIP   right_handtip_zed  RIGHT_HAND
RIGHT_THUMB     right_thumb_zed    RIGHT_WRIST
LEFT_HIP        left_hip           PELVIS
LEFT_KNEE       left_knee          LEFT_HIP
LEFT_ANKLE      left_ankle         LEFT_KNEE
LEFT_FOOT       left_foot_zed      LEFT_ANKLE
RIGHT_HIP       right_hip          PELVIS
RIGHT_KNEE      right_knee         RIGHT_HIP
RIGHT_ANKLE     right_ankle        RIGHT_KNEE
RIGHT_FOOT      right_foot_zed     RIGHT_ANKLE
HEAD            -                  NECK
NOSE            nose               HEAD
LEFT_EYE        left_eye           NOSE
LEFT_EAR        left_ear           LEFT_EYE
RIGHT_EYE       right_eye          NOSE
RIGHT_EAR       right_ear          RIGHT_EYE
LEFT_HEEL       left_heel          LEFT_ANKLE
RIGHT_HEEL      right_heel         RIGHT_ANKLE
"""

# ZED SDK, BODY_38.
ZED38 = """
PELVIS               pelvis                   -
SPINE_1              -                        PELVIS
SPINE_2              -                        SPINE_1
SPINE_3              -                        SPINE_2
NECK                 neck                     SPINE_3
NOSE                 nose                     NECK
LEFT_EYE             left_eye                 NOSE
RIGHT_EYE            right_eye                NOSE
LEFT_EAR             left_ear                 LEFT_EYE
RIGHT_EAR            right_ear                RIGHT_EYE
LEFT_CLAVICLE        left_clavicle            SPINE_3
RIGHT_CLAVICLE       right_clavicle           SPINE_3
LEFT_SHOULDER        left_shoulder            LEFT_CLAVICLE
RIGHT_SHOULDER       right_shoulder           RIGHT_CLAVICLE
LEFT_ELBOW           left_elbow               LEFT_SHOULDER
RIGHT_ELBOW          right_elbow              RIGHT_SHOULDER
LEFT_WRIST           left_wrist               LEFT_ELBOW
RIGHT_WRIST          right_wrist              RIGHT_ELBOW
LEFT_HIP             left_hip                 PELVIS
RIGHT_HIP            right_hip                PELVIS
LEFT_KNEE            left_knee                LEFT_HIP
RIGHT_KNEE           right_knee               RIGHT_HIP
LEFT_ANKLE           left_ankle               LEFT_KNEE
RIGHT_ANKLE          right_ankle              RIGHT_KNEE
LEFT_BIG_TOE         left_big_toe             LEFT_ANKLE
RIGHT_BIG_TOE        right_big_toe            RIGHT_ANKLE
LEFT_SMALL_TOE       left_small_toe           LEFT_ANKLE
RIGHT_SMALL_TOE      right_small_toe          RIGHT_ANKLE
LEFT_HEEL            left_heel                LEFT_ANKLE
RIGHT_HEEL           right_heel               RIGHT_ANKLE
LEFT_HAND_THUMB_4    left_hand_thumb_4_zed    LEFT_WRIST
RIGHT_HAND_THUMB_4   right_hand_thumb_4_zed   RIGHT_WRIST
LEFT_HAND_INDEX_1    left_hand_index_1_zed    LEFT_WRIST
RIGHT_HAND_INDEX_1   right_hand_index_1_zed   RIGHT_WRIST
LEFT_HAND_MIDDLE_4   left_hand_middle_4_zed   LEFT_WRIST
RIGHT_HAND_MIDDLE_4  right_hand_middle_4_zed  RIGHT_WRIST
LEFT_HAND_PINKY_1    left_hand_pinky_1_zed    LEFT_WRIST
RIGHT_HAND_PINKY_1   right_hand_pinky_1_zed   RIGHT_WRIST
"""

# Xsens MVN, the segments of xsens_mvn_ros2: names of bones, of which each point is the upper end.
# A shoulder is the collar bone's, so the joint of the arm is `upper_arm`.
XSENS23 = """
pelvis           pelvis          -
l5               -               pelvis
l3               -               l5
t12              -               l3
t8               -               t12
neck             -               t8
head             -               neck
right_shoulder   -               t8
right_upper_arm  right_shoulder  right_shoulder
right_forearm    right_elbow     right_upper_arm
right_hand       right_wrist     right_forearm
left_shoulder    -               t8
left_upper_arm   left_shoulder   left_shoulder
left_forearm     left_elbow      left_upper_arm
left_hand        left_wrist      left_forearm
right_upper_leg  right_hip       pelvis
right_lower_leg  right_knee      right_upper_leg
right_foot       right_ankle     right_lower_leg
right_toe        right_toe_base  right_foot
left_upper_leg   left_hip        pelvis
left_lower_leg   left_knee       left_upper_leg
left_foot        left_ankle      left_lower_leg
left_toe         left_toe_base   left_foot
"""
