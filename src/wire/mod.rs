//! Sans-IO codecs of the UR controller: RTDE, dashboard, primary interface. Bytes and numbers only.
