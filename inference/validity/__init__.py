"""When does it pay to combine two chains?"""
