# SPDX-License-Identifier: Apache-2.0
"""Published joint orders, as data.

One line per joint, in the order of the publication: its name there, the landmark of the body that
it is ('-' where no other convention has it), and the joints that a drawing connects it with.
Landmarks are equal only where two conventions mean the same point of the body, within the few
centimetres by which detectors differ. The hip centre of Kinect 360, for instance, lies well above
the middle of the hips and is no `pelvis`; Human3.6M's `Head` is the jaw.
"""

# COCO keypoints (person_keypoints_*.json, categories[0].keypoints); AIST++ has the same.
COCO17 = """
nose            nose            -
left_eye        left_eye        nose
right_eye       right_eye       nose
left_ear        left_ear        left_eye
right_ear       right_ear       right_eye
left_shoulder   left_shoulder   left_ear
right_shoulder  right_shoulder  right_ear left_shoulder
left_elbow      left_elbow      left_shoulder
right_elbow     right_elbow     right_shoulder
left_wrist      left_wrist      left_elbow
right_wrist     right_wrist     right_elbow
left_hip        left_hip        left_shoulder
right_hip       right_hip       right_shoulder left_hip
left_knee       left_knee       left_hip
right_knee      right_knee      right_hip
left_ankle      left_ankle      left_knee
right_ankle     right_ankle     right_knee
"""

# OpenPose, POSE_BODY_25_BODY_PARTS.
BODY25 = """
Nose       nose             Neck
Neck       neck             -
RShoulder  right_shoulder   Neck
RElbow     right_elbow      RShoulder
RWrist     right_wrist      RElbow
LShoulder  left_shoulder    Neck
LElbow     left_elbow       LShoulder
LWrist     left_wrist       LElbow
MidHip     pelvis           Neck
RHip       right_hip        MidHip
RKnee      right_knee       RHip
RAnkle     right_ankle      RKnee
LHip       left_hip         MidHip
LKnee      left_knee        LHip
LAnkle     left_ankle       LKnee
REye       right_eye        Nose
LEye       left_eye         Nose
REar       right_ear        REye
LEar       left_ear         LEye
LBigToe    left_big_toe     LAnkle
LSmallToe  left_small_toe   LBigToe
LHeel      left_heel        LAnkle
RBigToe    right_big_toe    RAnkle
RSmallToe  right_small_toe  RBigToe
RHeel      right_heel       RAnkle
"""

# Halpe Full-Body, its first 26 (AlphaPose, RTMPose body_26).
HALPE26 = """
Nose       nose             Neck
LEye       left_eye         Nose
REye       right_eye        Nose
LEar       left_ear         LEye
REar       right_ear        REye
LShoulder  left_shoulder    Neck
RShoulder  right_shoulder   Neck
LElbow     left_elbow       LShoulder
RElbow     right_elbow      RShoulder
LWrist     left_wrist       LElbow
RWrist     right_wrist      RElbow
LHip       left_hip         Hip
RHip       right_hip        Hip
LKnee      left_knee        LHip
RKnee      right_knee       RHip
LAnkle     left_ankle       LKnee
RAnkle     right_ankle      RKnee
Head       head_top         Neck
Neck       neck             -
Hip        pelvis           Neck
LBigToe    left_big_toe     LAnkle
RBigToe    right_big_toe    RAnkle
LSmallToe  left_small_toe   LBigToe
RSmallToe  right_small_toe  RBigToe
LHeel      left_heel        LAnkle
RHeel      right_heel       RAnkle
"""

# Human3.6M, the 17 of the 32 that move (0 1 2 3 6 7 8 12 13 14 15 17 18 19 25 26 27).
H36M17 = """
Hip        pelvis          -
RHip       right_hip       Hip
RKnee      right_knee      RHip
RFoot      right_ankle     RKnee
LHip       left_hip        Hip
LKnee      left_knee       LHip
LFoot      left_ankle      LKnee
Spine      spine_h36m      Hip
Thorax     neck            Spine
Neck       jaw             Thorax
Head       head_top        Neck
LShoulder  left_shoulder   Thorax
LElbow     left_elbow      LShoulder
LWrist     left_wrist      LElbow
RShoulder  right_shoulder  Thorax
RElbow     right_elbow     RShoulder
RWrist     right_wrist     RElbow
"""

# Human3.6M, metadata.xml: names of bones, of which each point is the upper end. The seven named
# Site there carry the name of their bone. Spine lies on Hips, both Shoulders on Neck, the Thumbs
# and Wrist_Ends on the Hands.
H36M32 = """
Hips                pelvis                -
RightUpLeg          right_hip             Hips
RightLeg            right_knee            RightUpLeg
RightFoot           right_ankle           RightLeg
RightToeBase        right_toe_base        RightFoot
RightToeBaseSite    right_toe_tip         RightToeBase
LeftUpLeg           left_hip              Hips
LeftLeg             left_knee             LeftUpLeg
LeftFoot            left_ankle            LeftLeg
LeftToeBase         left_toe_base         LeftFoot
LeftToeBaseSite     left_toe_tip          LeftToeBase
Spine               -                     Hips
Spine1              spine_h36m            Spine
Neck                neck                  Spine1
Head                jaw                   Neck
HeadSite            head_top              Head
LeftShoulder        left_neck             Neck
LeftArm             left_shoulder         LeftShoulder
LeftForeArm         left_elbow            LeftArm
LeftHand            left_wrist            LeftForeArm
LeftHandThumb       left_thumb_base       LeftHand
LeftHandThumbSite   left_thumb_tip        LeftHandThumb
L_Wrist_End         left_wrist_end        LeftHand
L_Wrist_EndSite     left_hand_end         L_Wrist_End
RightShoulder       right_neck            Neck
RightArm            right_shoulder        RightShoulder
RightForeArm        right_elbow           RightArm
RightHand           right_wrist           RightForeArm
RightHandThumb      right_thumb_base      RightHand
RightHandThumbSite  right_thumb_tip       RightHandThumb
R_Wrist_End         right_wrist_end       RightHand
R_Wrist_EndSite     right_hand_end        R_Wrist_End
"""

# MPI-INF-3DHP, util/mpii_get_joints.m, joint set 'all'.
MPI28 = """
spine3          -               spine2
spine4          -               spine3
spine2          -               spine
spine           -               pelvis
pelvis          pelvis          -
neck            neck            spine4
head            -               neck
head_top        head_top        head
left_clavicle   left_clavicle   spine4
left_shoulder   left_shoulder   left_clavicle
left_elbow      left_elbow      left_shoulder
left_wrist      left_wrist      left_elbow
left_hand       left_hand       left_wrist
right_clavicle  right_clavicle  spine4
right_shoulder  right_shoulder  right_clavicle
right_elbow     right_elbow     right_shoulder
right_wrist     right_wrist     right_elbow
right_hand      right_hand      right_wrist
left_hip        left_hip        pelvis
left_knee       left_knee       left_hip
left_ankle      left_ankle      left_knee
left_foot       left_toe_base   left_ankle
left_toe        left_toe_tip    left_foot
right_hip       right_hip       pelvis
right_knee      right_knee      right_hip
right_ankle     right_ankle     right_knee
right_foot      right_toe_base  right_ankle
right_toe       right_toe_tip   right_foot
"""

# Kinect for Windows SDK 1.x, NUI_SKELETON_POSITION_INDEX.
KINECT20 = """
HIP_CENTER       -               -
SPINE            -               HIP_CENTER
SHOULDER_CENTER  neck            SPINE
HEAD             -               SHOULDER_CENTER
SHOULDER_LEFT    left_shoulder   SHOULDER_CENTER
ELBOW_LEFT       left_elbow      SHOULDER_LEFT
WRIST_LEFT       left_wrist      ELBOW_LEFT
HAND_LEFT        left_hand       WRIST_LEFT
SHOULDER_RIGHT   right_shoulder  SHOULDER_CENTER
ELBOW_RIGHT      right_elbow     SHOULDER_RIGHT
WRIST_RIGHT      right_wrist     ELBOW_RIGHT
HAND_RIGHT       right_hand      WRIST_RIGHT
HIP_LEFT         left_hip        HIP_CENTER
KNEE_LEFT        left_knee       HIP_LEFT
ANKLE_LEFT       left_ankle      KNEE_LEFT
FOOT_LEFT        left_foot       ANKLE_LEFT
HIP_RIGHT        right_hip       HIP_CENTER
KNEE_RIGHT       right_knee      HIP_RIGHT
ANKLE_RIGHT      right_ankle     KNEE_RIGHT
FOOT_RIGHT       right_foot      ANKLE_RIGHT
"""

# Azure Kinect body tracking, k4abt_joint_id_t.
AZURE32 = """
PELVIS          pelvis            -
SPINE_NAVEL     -                 PELVIS
SPINE_CHEST     -                 SPINE_NAVEL
NECK            neck              SPINE_CHEST
CLAVICLE_LEFT   left_clavicle     SPINE_CHEST
SHOULDER_LEFT   left_shoulder     CLAVICLE_LEFT
ELBOW_LEFT      left_elbow        SHOULDER_LEFT
WRIST_LEFT      left_wrist        ELBOW_LEFT
HAND_LEFT       left_hand         WRIST_LEFT
HANDTIP_LEFT    left_hand_tip     HAND_LEFT
THUMB_LEFT      left_thumb        WRIST_LEFT
CLAVICLE_RIGHT  right_clavicle    SPINE_CHEST
SHOULDER_RIGHT  right_shoulder    CLAVICLE_RIGHT
ELBOW_RIGHT     right_elbow       SHOULDER_RIGHT
WRIST_RIGHT     right_wrist       ELBOW_RIGHT
HAND_RIGHT      right_hand        WRIST_RIGHT
HANDTIP_RIGHT   right_hand_tip    HAND_RIGHT
THUMB_RIGHT     right_thumb       WRIST_RIGHT
HIP_LEFT        left_hip          PELVIS
KNEE_LEFT       left_knee         HIP_LEFT
ANKLE_LEFT      left_ankle        KNEE_LEFT
FOOT_LEFT       left_foot         ANKLE_LEFT
HIP_RIGHT       right_hip         PELVIS
KNEE_RIGHT      right_knee        HIP_RIGHT
ANKLE_RIGHT     right_ankle       KNEE_RIGHT
FOOT_RIGHT      right_foot        ANKLE_RIGHT
HEAD            -                 NECK
NOSE            nose              HEAD
EYE_LEFT        left_eye          NOSE
EAR_LEFT        left_ear          EYE_LEFT
EYE_RIGHT       right_eye         NOSE
EAR_RIGHT       right_ear         EYE_RIGHT
"""

# MediaPipe Pose, PoseLandmark.
MEDIAPIPE33 = """
nose              nose             -
left_eye_inner    left_eye_inner   nose
left_eye          left_eye         left_eye_inner
left_eye_outer    left_eye_outer   left_eye
right_eye_inner   right_eye_inner  nose
right_eye         right_eye        right_eye_inner
right_eye_outer   right_eye_outer  right_eye
left_ear          left_ear         left_eye_outer
right_ear         right_ear        right_eye_outer
mouth_left        left_mouth       -
mouth_right       right_mouth      mouth_left
left_shoulder     left_shoulder    -
right_shoulder    right_shoulder   left_shoulder
left_elbow        left_elbow       left_shoulder
right_elbow       right_elbow      right_shoulder
left_wrist        left_wrist       left_elbow
right_wrist       right_wrist      right_elbow
left_pinky        left_pinky       left_wrist
right_pinky       right_pinky      right_wrist
left_index        left_index       left_wrist left_pinky
right_index       right_index      right_wrist right_pinky
left_thumb        left_thumb_knuckle   left_wrist
right_thumb       right_thumb_knuckle  right_wrist
left_hip          left_hip         left_shoulder
right_hip         right_hip        right_shoulder left_hip
left_knee         left_knee        left_hip
right_knee        right_knee       right_hip
left_ankle        left_ankle       left_knee
right_ankle       right_ankle      right_knee
left_heel         left_heel        left_ankle
right_heel        right_heel       right_ankle
left_foot_index   left_big_toe     left_heel left_ankle
right_foot_index  right_big_toe    right_heel right_ankle
"""

# Joint centres of Vicon's Plug-in Gait. The model gives them no order: this one is ours.
PLUG_IN_GAIT = """
LHipJC       left_hip        RHipJC LShoulderJC
LKneeJC      left_knee       LHipJC
LAnkleJC     left_ankle      LKneeJC
RHipJC       right_hip       RShoulderJC
RKneeJC      right_knee      RHipJC
RAnkleJC     right_ankle     RKneeJC
LShoulderJC  left_shoulder   RShoulderJC
LElbowJC     left_elbow      LShoulderJC
LWristJC     left_wrist      LElbowJC
RShoulderJC  right_shoulder  -
RElbowJC     right_elbow     RShoulderJC
RWristJC     right_wrist     RElbowJC
"""
